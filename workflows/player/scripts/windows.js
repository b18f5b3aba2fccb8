// The later files of a scene whose page and data lie apart: each holds what is seen in one stretch of time alone.

export class Windows {
  // header: of the scene. address: of its first file. add: takes a window's number and bytes, and is done when it can be drawn.
  constructor(header, address, add) {
    this.add = add;
    this.list = (header.windows ?? []).map(([from, to], k) => ({ k, from, to, address: address.replace(/(\.\w+)?(\?.*)?$/, `-${k + 1}$1$2`) }));
  }

  // Done when all that is seen at `time` is there; fails if some of it cannot be had.
  async at(time) {
    await Promise.all(this.#seen(time).map((one) => this.#got(one)));
  }

  // Whether some of what is seen at `time` is still on its way.
  lacks(time) {
    return this.#seen(time).some((one) => !one.settled);
  }

  // Fetches all windows, one after the other: at each step the next that plays after the time `now()`. `trouble` hears of those that fail.
  async fetchAll(now, trouble) {
    for (;;) {
      const time = now(), left = this.list.filter((one) => !one.settled), next = left.find((one) => one.to >= time) ?? left[0];
      if (!next) return;
      await this.#got(next).catch(trouble);
    }
  }

  #seen(time) {
    return this.list.filter((one) => one.from <= time && time <= one.to);
  }

  #got(one) {
    one.got ??= (async () => {
      try {
        await this.add(one.k, await fetched(one.address));
      } catch (error) {
        throw new Error(`A part of the scene is missing (${nameOf(one.address)}): ${error.message}`);
      } finally {
        one.settled = true;
      }
    })();
    return one.got;
  }
}

const nameOf = (address) => address.split("?")[0];  // without the digest of the content

export async function fetched(address) {
  try {
    const answer = await fetch(address);
    if (!answer.ok) throw new Error(String(answer.status));
    return new Uint8Array(await answer.arrayBuffer());
  } catch (error) {
    const local = location.protocol === "file:" ? " A browser reads it from a web server only; a page with the data inside needs none." : "";
    throw new Error(`The scene's data (${nameOf(address)}) cannot be read: ${error.message}.${local}`);
  }
}
