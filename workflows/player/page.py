"""Puts the page together: modules, shaders, style, poster and data in one HTML file that asks nobody for anything."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from pathlib import Path

FOLDER = Path(__file__).parent
IMPORT = re.compile(r'^import \{ ([\w, ]+) \} from "\./(\w+)\.js";\n', re.MULTILINE)
EXPORT = re.compile(r"^export (?=(?:async )?(?:function|class|const) (\w+))", re.MULTILINE)


def page(title: str, scene: bytes | str, poster: bytes | None, background: tuple[float, float, float], play: bool = True) -> str:
    """The HTML of the player.

    scene: the file of `scene.formats.web`, which becomes part of the page; or its address relative to the page, which must then come from
    a web server. poster: a JPEG, shown until the scene is. background: RGB in [0, 1]. play: whether time runs when the page opens.
    """
    import jinja2
    from markupsafe import Markup

    shade = "#" + "".join(f"{round(255 * min(max(x, 0.0), 1.0)):02x}" for x in background)
    style = (FOLDER / "player.css").read_text(encoding="utf-8").replace("BACKGROUND", shade)
    script = bundle("main", "start")
    policy = {
        "default-src": "'none'",
        "script-src": digest_of(script),
        "style-src": digest_of(style),
        "img-src": "data:",
        "worker-src": "blob:",
    }
    if isinstance(scene, str):
        policy["connect-src"] = "'self'"
    environment = jinja2.Environment(loader=jinja2.FileSystemLoader(FOLDER), autoescape=True, undefined=jinja2.StrictUndefined)
    return environment.get_template("page.html.jinja").render(
        title=title,
        policy="; ".join(f"{name} {value}" for name, value in policy.items()),
        style=Markup(style),
        script=Markup(script),
        worker=Markup(bundle("worker", "answersTo", "self")),
        poster=None if poster is None else "data:image/jpeg;base64," + base64.b64encode(poster).decode(),
        data=None if isinstance(scene, str) else Markup(base64.b64encode(scene).decode()),
        address=scene if isinstance(scene, str) else None,
        play=play,
    )


def digest_of(text: str) -> str:
    """``text`` of an inline script or style, as a content security policy allows it."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def bundle(entry: str, call: str, *arguments: str) -> str:
    """One script of the module ``entry`` and all that it imports, each in a function of its own, that calls ``call`` of ``entry``.

    Modules import names from "./other.js" on one line each, and export functions, classes and constants where they are declared.
    """
    parts: list[str] = []
    done: set[str] = set()

    def add(name: str) -> None:
        if name in done:
            return
        done.add(name)
        text = source_of(name)
        for _, other in IMPORT.findall(text):
            add(other)
        exported = EXPORT.findall(text)
        body = EXPORT.sub("", IMPORT.sub(lambda found: f"const {{ {found[1]} }} = {found[2]}_js;\n", text))
        parts.append(f"const {name}_js = (() => {{\n{body}return {{ {', '.join(exported)} }};\n}})();\n")

    add(entry)
    return f'"use strict";\n(() => {{\n{"".join(parts)}{entry}_js.{call}({", ".join(arguments)});\n}})();\n'


def source_of(name: str) -> str:
    """The text of a module; "shaders" is made of the files in shaders/: `draw.vert.glsl` is `shaders.draw_vert`."""
    if name != "shaders":
        return (FOLDER / "scripts" / f"{name}.js").read_text(encoding="utf-8")
    texts = {
        path.name.removesuffix(".glsl").replace(".", "_"): path.read_text(encoding="utf-8")
        for path in sorted((FOLDER / "shaders").glob("*.glsl"))
    }
    return f"export const shaders = {json.dumps(texts)};\n"
