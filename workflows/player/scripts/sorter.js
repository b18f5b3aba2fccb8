// Opens a scene and sorts it in a worker, or on the page's own thread where a page may have no workers.
import { Answers } from "./worker.js";

// { scene, sorter } of the file `bytes`, whose buffer may be taken away. Throws an Error that says what is wrong with the file.
export async function startSorter(bytes) {
  const waiting = new Map(), spare = [];
  let settle = null;
  const heard = (message) => {
    const { done, failed } = waiting.get(message.id) ?? {};
    waiting.delete(message.id);
    if (message.kind === "refused") failed(new Error(message.message));
    else (done ?? settle)(message);
  };
  const send = await connect(heard);
  const opened = await new Promise((done) => {
    settle = done;
    send({ kind: "open", bytes }, [bytes.buffer]);
  });
  if (opened.kind === "failed") throw new Error(opened.message);
  settle = ({ message }) => waiting.forEach(({ failed }) => failed(new Error(message)));
  let id = 0;
  const ask = (message, moved) =>
    new Promise((done, failed) => {
      waiting.set(++id, { done, failed });
      send({ id, ...message }, moved);
    });
  const sort = (time, row, layer = "all", order = spare.pop()) => ask({ kind: "sort", time, row, layer, order }, order ? [order.buffer] : []);
  // The decoded window, whose file is `bytes`.
  const add = async (window, bytes) => (await ask({ kind: "add", window, bytes }, [bytes.buffer])).part;
  return { scene: opened.scene, sorter: { sort, add, give: (order) => spare.push(order) } };
}

// A function that sends messages, when what will answer them is there. A site may forbid workers, which the page hears only after it has made
// one; until then nothing is handed over.
function connect(heard) {
  return new Promise((done) => {
    const here = () => {
      const answers = new Answers(heard);
      done((message) => answers.take(message));
    };
    try {
      const address = URL.createObjectURL(new Blob([document.getElementById("worker").textContent], { type: "text/javascript" }));
      const worker = new Worker(address);
      let there = false, broken = null;
      worker.onmessage = ({ data }) => {
        if (data.kind !== "there") return heard(data);
        there = true;
        done((message, moved) => (broken ? heard(broken) : worker.postMessage(message, moved)));
      };
      worker.onerror = (event) => {
        if (there) heard((broken = { kind: "failed", message: event.message || "The page's worker has failed." }));
        else here();
      };
    } catch {
      here();
    }
  });
}
