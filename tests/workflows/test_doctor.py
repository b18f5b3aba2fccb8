"""`e4dgs doctor`: one row for each library that this machine needs."""

import platform
import sys

from e4dgs.workflows.machine import doctor

ASKED = [
    "numpy>=1.26",
    "nosuchpackage-e4dgs>=1",
    f"open3d-cpu>=0.18; (platform_system == '{platform.system()}' and platform_machine == '{platform.machine()}') and extra == 'usd'",
    f"open3d>=0.18; (platform_system != '{platform.system()}' or platform_machine != '{platform.machine()}') and extra == 'usd'",
    "parsl>=2025.1; extra == 'cluster'",
    "pytest>=8; extra == 'dev'",
    f"numpy>=1; sys_platform != '{sys.platform}'",
]


def test_a_library_for_other_machines_is_not_asked_for(monkeypatch):
    """It said that open3d-cpu is there, and that open3d is not and could be installed."""
    monkeypatch.setattr(doctor.metadata, "requires", lambda name: ASKED)
    monkeypatch.setattr(doctor, "find_spec", lambda name: None)
    monkeypatch.setattr(doctor, "_version", lambda name: "1.0" if name in ("numpy", "parsl") else None)
    rows = {name: (well, detail) for name, well, detail in doctor._libraries()}
    assert rows == {
        "numpy": (True, "1.0"),
        "nosuchpackage-e4dgs": (False, "not installed; install e4dgs again with its dependencies"),
        "open3d-cpu": (None, "optional: pip install 'e4dgs[usd]'"),
        "parsl": (True, "1.0"),
    }
