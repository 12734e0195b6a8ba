# SPDX-License-Identifier: Apache-2.0
"""Generates the page of faults from the registry, and draws a picture of each.

``python tools/faults_page.py docs/`` writes ``docs/faults.md`` and ``docs/images/faults/``; with
``--check`` it exits with 1 if the page is out of date.
"""

from __future__ import annotations

import inspect
import re
import sys
from pathlib import Path

from ftcm_core.faults import (
    ActuatorFault,
    AdditiveFault,
    CommunicationFault,
    Fault,
    JointFault,
    ProfiledFault,
    RobotFault,
    SensorFault,
)
from ftcm_core.params import specs
from ftcm_core.registry import components
from ftcm_core.report.fault_pictures import write_picture, write_profiles
from reference_page import escape, table
from topics_page import write_or_check

FILE, PICTURES, PROFILES = "faults.md", Path("images/faults"), "profiles.svg"

_INTRO = """# Faults

Generated from the code by `python tools/faults_page.py docs/`; do not edit. How faults are written in a
scenario: [scenarios](scenarios.md#faults). Where each site acts in a tick:
[architecture](architecture.md#faults-by-site). How to write one: [extending](extending.md#a-fault).

Of a fault one says *what* becomes of a signal (its type), *when* (trigger and lifetime) and *how much*
(profile and severity). It acts at onset < t ≤ end. The ψ of the formulas below is the profile's value times
the severity, 0 while the fault does not act. The faults of a site act one after the other in the order of
their rank, whatever their order in the scenario. Every fault has random numbers of its own, from the
scenario's seed.

The pictures are made by the classes themselves, at their defaults:

| site | picture |
|---|---|
| actuator, sensor | steps with a test signal: sines of 1 Hz, joint 1 |
| dynamics | a run of the paper's scenario with this fault alone |
| communication | steps with numbered messages |

`ftcm describe NAME --picture FILE` draws one, with other parameters by `--set`:

```
ftcm describe sensor_drift --picture drift.svg --set walk=0.002 profile=ramp
```
"""
_SITES: dict[str, tuple[type[Fault], ...]] = {
    "Actuators": (ActuatorFault,),
    "Sensors": (SensorFault,),
    "Dynamics": (AdditiveFault, RobotFault),
    "Communication": (CommunicationFault,),
}
_LIFETIME = ("lifetime", "duration")


def page() -> str:
    """Return the page, in Markdown."""
    shared = specs(Fault)
    of_profile = [s for name, s in specs(ProfiledFault).items() if name not in shared]
    of_joint = [s for name, s in specs(JointFault).items() if name not in specs(ProfiledFault)]
    of_topic = [s for name, s in specs(CommunicationFault).items() if name not in specs(ProfiledFault)]
    parts = [
        _INTRO,
        "## Trigger",
        markdown(Fault),
        table(s for name, s in shared.items() if name not in _LIFETIME),
        "## Lifetime",
        "What ends a fault. One that is cleared by hand can be armed by hand again.",
        table(shared[name] for name in _LIFETIME),
        "## Profile",
        markdown(ProfiledFault) + " Changes of the robot have none: they are there or not.",
        table(of_profile),
        f"![The time profiles](./{PICTURES / PROFILES})",
        "## Joint, topic",
        table([*of_joint, *of_topic]),
    ]
    for title, bases in _SITES.items():
        found = [cls for cls in components("fault").values() if issubclass(cls, bases)]
        parts += [f"## {title}", *(f"`{base.__name__}`: {markdown(base)}" for base in bases)]
        for cls in sorted(found, key=lambda cls: (getattr(cls, "rank", 0), cls.type_name)):
            parts += of_fault(cls)
    return "\n\n".join(part.strip() for part in parts) + "\n"


def of_fault(cls: type) -> list[str]:
    """Return what the page says of a fault: its name, itself in words, where the rest is, its picture."""
    name = cls.type_name  # type: ignore[attr-defined]
    return [
        f"### `{name}`",
        markdown(sys.modules[cls.__module__]),
        markdown(cls),
        f"Rank {cls.rank}. [Parameters, units, sources](reference.md#{name}).",  # type: ignore[attr-defined]
        f"![What {name} does](./{PICTURES / name}.svg)",
    ]


def markdown(documented: object) -> str:
    """Return a docstring as Markdown."""
    text = inspect.getdoc(documented) or ""
    text = re.sub(r":\w+:`~?(?:\w+\.)*(\w+)`", r"`\1`", text.replace("``", "`"))
    return escape(text)


def draw(folder: Path) -> None:
    """Draw every picture of the page, and remove those of faults that are no more."""
    pictures = folder / PICTURES
    pictures.mkdir(parents=True, exist_ok=True)
    write_profiles(pictures / PROFILES)
    faults = components("fault")
    for name, cls in faults.items():
        fault = cls()
        assert isinstance(fault, Fault)
        write_picture(fault, pictures / f"{name}.svg")
    for file in pictures.glob("*.svg"):
        if file.name != PROFILES and file.stem not in faults:
            file.unlink()


def main() -> int:
    """Write the page and its pictures, or check the page on disk."""
    return write_or_check("tools/faults_page.py", __doc__, FILE, page(), draw)


if __name__ == "__main__":
    sys.exit(main())
