"""The controls beside the picture: time, what is shown, and the capture's cameras."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import viser

from .looks import LOOKS, PRIMITIVES

SECONDS = 5.0  # duration of the capture at speed 1 if the capture does not give one


class Controls(NamedTuple):
    """The state of all controls at one moment."""

    time: float
    primitives: str
    look: str
    outlines: bool
    photo: float
    longest: int


class Panel:
    """The controls of one browser.

    gui: of that browser. names: of the frames that have a camera to go to. seconds: duration of the capture. go: called with the index
    into ``names`` that a person chooses.
    """

    def __init__(self, gui: viser.GuiApi, names: list[str], seconds: float, go: Callable[[int], None]) -> None:
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        gui.set_panel_label("e4dgs")
        self._names, self._seconds = names, seconds if seconds > 0 else SECONDS
        self._title = gui.add_markdown("")
        with gui.add_folder("Time"):
            self._time = gui.add_slider("Time", 0.0, 1.0, 0.001, 0.0)
            self._play = gui.add_checkbox("Play", False)
            self._speed = gui.add_slider("Speed", 0.1, 4.0, 0.1, 1.0, hint="1 is the speed of the capture")
        with gui.add_folder("Show"):
            self._look = gui.add_dropdown("Picture", LOOKS)
            self._primitives = gui.add_dropdown("Primitives", PRIMITIVES)
            self._outlines = gui.add_checkbox("Outlines of convexes", False)
            self._longest = gui.add_slider("Longest side, px", 200, 2400, 100, 1200, hint="of the picture once nothing moves")
        with gui.add_folder("Cameras of the capture"):
            self._frame = gui.add_slider("Frame", 0, max(len(names) - 1, 0), 1, 0)
            self._name = gui.add_markdown("")
            self._photo = gui.add_slider("Photo", 0.0, 1.0, 0.01, 0.0, hint="how much of the picture is the photo, from the left")
            self._frame.on_update(lambda event: go(int(self._frame.value)))

    def choice(self) -> Controls:
        photo, longest = float(self._photo.value), int(self._longest.value)
        return Controls(float(self._time.value), self._primitives.value, self._look.value, self._outlines.value, photo, longest)

    @property
    def playing(self) -> bool:
        return bool(self._play.value)

    def advance(self, seconds: float) -> None:
        """Advances time by ``seconds`` of real time; it starts again at its end."""
        self._set_time((float(self._time.value) + seconds * float(self._speed.value) / self._seconds) % 1.0)

    def _set_time(self, time: float) -> None:
        self._time.value = round(time, 4)  # type: ignore[misc]  # getter and setter have different types

    def at_frame(self, row: int, time: float) -> None:
        """Shows that the camera is where frame ``row`` was taken."""
        self._set_time(time)
        self._play.value = False  # type: ignore[misc]
        self._name.content = f"`{self._names[row]}`"

    def say(self, title: str) -> None:
        if self._title.content != title:
            self._title.content = title
