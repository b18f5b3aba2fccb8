"""A stand-in for the API server of Kubernetes that knows pods alone: each one is a process of this host. What is sent is kept."""

import contextlib
import json
import subprocess
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import psutil
import yaml


class PodServer:
    """run: start what pods ask for. ``pods``: bodies of the requests that made them, as they came, in order."""

    def __init__(self, run: bool = False) -> None:
        self.run, self.pods, self._processes = run, [], {}
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), _handler(self))
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,))
        self._thread.start()

    def config(self, folder: Path) -> Path:
        """A file for KUBECONFIG."""
        file, name = folder / "kubeconfig", "here"
        cluster = {"name": name, "cluster": {"server": f"http://127.0.0.1:{self._server.server_port}"}}
        context = {"name": name, "context": {"cluster": name, "user": name}}
        content = {"clusters": [cluster], "contexts": [context], "users": [{"name": name, "user": {}}], "current-context": name}
        file.write_text(yaml.safe_dump({"apiVersion": "v1", "kind": "Config", **content}))
        return file

    def names(self) -> list[str]:
        """Of the pods that there are now."""
        return list(self._processes)

    def start(self, pod: dict[str, Any]) -> None:
        self.pods.append(pod)
        (container,) = pod["spec"]["containers"]
        command = [*container["command"], *container["args"]] if self.run else ["sleep", "600"]
        self._processes[pod["metadata"]["name"]] = subprocess.Popen(command, start_new_session=True, stdout=subprocess.DEVNULL)

    def phase(self, name: str) -> str | None:
        """None: there is no such pod."""
        process = self._processes.get(name)
        if process is None:
            return None
        return "Running" if process.poll() is None else "Failed" if process.returncode else "Succeeded"

    def end(self, name: str) -> None:
        """As an eviction does: the pod is gone with all that ran in it, and nobody is told."""
        process = self._processes.pop(name)
        if process.poll() is None:
            for one in (*psutil.Process(process.pid).children(recursive=True), process):
                with contextlib.suppress(psutil.Error):
                    one.kill()
            process.wait()

    def close(self) -> None:
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()
        for name in self.names():
            self.end(name)


def _handler(pods: PodServer) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def answer(self, content: dict[str, Any], code: int = 200) -> None:
            body = json.dumps(content).encode()
            self.send_response(code)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def body(self) -> dict[str, Any]:
            return json.loads(self.rfile.read(int(self.headers.get("Content-Length", 0))) or b"{}")

        def named(self, then_ended: bool) -> None:
            self.body()
            name = self.path.split("?")[0].rpartition("/")[2]
            phase = pods.phase(name)
            if phase is None:
                return self.answer({"kind": "Status", "apiVersion": "v1", "status": "Failure", "reason": "NotFound", "code": 404}, 404)
            if then_ended:
                pods.end(name)
            self.answer({"kind": "Pod", "apiVersion": "v1", "metadata": {"name": name}, "status": {"phase": phase}})

        def do_POST(self) -> None:
            pod = self.body()
            assert self.path.split("?")[0].endswith("/pods"), self.path
            pod["metadata"]["namespace"] = self.path.split("/")[4]
            pods.start(pod)
            self.answer(pod | {"status": {"phase": "Pending"}}, 201)

        def do_GET(self) -> None:
            self.named(then_ended=False)

        def do_DELETE(self) -> None:
            self.named(then_ended=True)

        def log_message(self, *words: object) -> None:
            pass

    return Handler
