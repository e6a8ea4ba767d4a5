"""The layout of panels for Foxglove and Lichtblick: what happened at a glance, and a button a fault for a live bench.

The file has the form that both import and export: `configById` with the settings of every panel by its id, `layout` with
halves of halves. Paths to signals are written as both read them: /topic.field[0], /topic{field=="value"}.other.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Sequence
from typing import Any, Final

from tools.foxglove.buttons import Button, list_buttons
from tools.foxglove.scene import BODY_FRAME, INERTIAL
from tools.foxglove.schemas import BODY, FAULTS, WHEELS

Config = dict[str, Any]
Area = Any  # the id of a panel, or two areas and how they share the place

COLOURS: Final = ("#4e98e2", "#f5774d", "#58c470", "#b48ae0")
PALE: Final = ("#a9cdf2", "#fbc3ae", "#b2e4bd", "#dbc7f2")
AXES, WHEEL_NAMES = ("x", "y", "z"), ("wheel 1", "wheel 2", "wheel 3", "wheel 4")
UNITS: Final = ("wheel.1", "wheel.2", "wheel.3", "wheel.4", "gyro.x", "gyro.y", "gyro.z", "star_tracker", "bus")
FAMILIES: Final = {"wheel": "Break a wheel", "gyro": "Break the gyro", "star_tracker": "Break the star tracker",
                   "bus": "Break the bus"}  # fmt: skip
COLUMNS: Final = 5  # of buttons


def make_layout(topics: Collection[str] | None = None) -> Config:
    """The layout as JSON types. `topics`: of the log it is for; lines of others are left out. None: everything."""
    configs: dict[str, Config] = {
        "3D!scene": _scene(),
        "Plot!error": _plot("Pointing error [deg]", [("/truth/attitude.error_deg", "true", "#e0e0e0"),
                                                     ("/fsw/attitude.error_deg", "estimated", COLOURS[1])]),
        "Plot!rate": _plot("Body rate [rad/s]", _vector("/truth/attitude.omega_bi_b_rad_s", AXES, "", COLOURS)),
        "Plot!fault": _plot(
            "Fault torque and its estimate [N m]",
            _vector("/truth/wheels.tau_fault_b_nm", AXES, "true ", COLOURS)
            + _vector("/fsw/observer.tau_fault_hat_b_nm", AXES, "estimate ", PALE),
        ),
        "Plot!torque": _plot(
            "Wheel torque [N m]",
            _vector("/truth/wheels.tau_rw_true_nm", WHEEL_NAMES, "", COLOURS)
            + _vector("/fsw/control.tau_rw_cmd_nm", WHEEL_NAMES, "command ", PALE),
        ),
        "Plot!speed": _plot("Wheel speed [rad/s]", _vector("/truth/wheels.speed_rad_s", WHEEL_NAMES, "", COLOURS)),
        "StateTransitions!state": _transitions(),
        "RosOut!events": {"topicToRender": "/events", "minLogLevel": 1, "searchTerms": []} | _title("Events"),
        "RawMessages!executive": {"topicPath": "/fsw/executive"} | _title("Executive"),
        "RawMessages!health": {"topicPath": "/fsw/wheel_health"} | _title("Wheel health"),
        "RawMessages!faults": {"topicPath": "/faults"} | _title("Last word on faults"),
        "Plot!cycle": _plot("Cycle time [us]", [("/fsw/timing.cycle_us", "cycle", COLOURS[0])]),
    }  # fmt: skip
    if topics is not None:
        configs = {name: kept for name, config in configs.items() if (kept := _fit(config, topics)) is not None}
    run = _split(
        "row", 38,
        _split("column", 68, "3D!scene", "RosOut!events"),
        _split("row", 50, _stack("Plot!error", "Plot!rate", "Plot!fault"),
               _stack("Plot!torque", "Plot!speed", "StateTransitions!state")),
    )  # fmt: skip
    inside = _split(
        "row", 50,
        _split("column", 50, "RawMessages!executive", "RawMessages!health"),
        _split("column", 50, "RawMessages!faults", "Plot!cycle"),
    )  # fmt: skip
    tabs = [("Run", _prune(run, configs)), ("Inside", _prune(inside, configs))]
    for family, title in FAMILIES.items():
        panels = {_name(button): _call(button) for button in list_buttons() if button.family in (family, "all")}
        configs |= {f"{name}-{family}": config for name, config in panels.items()}
        tabs.append((f"{title} (live)", _grid([f"{name}-{family}" for name in panels])))
    configs["Tab!main"] = {"activeTabIdx": 0, "tabs": [{"title": name, "layout": area} for name, area in tabs if area]}
    return {
        "configById": configs,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": "Tab!main",
    }


def format_layout(layout: Config) -> str:
    """The layout file."""
    return json.dumps(layout, indent=2) + "\n"


def list_paths(layout: Config) -> list[str]:
    """Every path to a signal or topic that the panels of a layout show."""
    found: list[str] = []
    for config in layout["configById"].values():
        found += [series["value"] for series in config.get("paths", ())]
        found += [config[key] for key in ("topicPath", "topicToRender") if key in config]
        found += list(config.get("topics", ()))
    return found


def topic_of(path: str) -> str:
    """The topic of a path."""
    return re.split(r"[.{\[]", path, maxsplit=1)[0]


# -- panels --------------------------------------------------------------------------------------------------------


def _title(text: str) -> Config:
    return {"foxglovePanelTitle": text, "lichtblickPanelTitle": text}


def _scene() -> Config:
    return {
        "cameraState": {
            "perspective": True, "distance": 6.0, "phi": 62.0, "thetaOffset": 40.0, "targetOffset": [0, 0, 0],
            "target": [0, 0, 0], "targetOrientation": [0, 0, 0, 1], "fovy": 40, "near": 0.05, "far": 500,
        },
        "followMode": "follow-none",
        "followTf": INERTIAL,
        "scene": {"transforms": {"showLabel": True, "axisSize": 1.2, "enablePreloading": True}},
        "transforms": {f"frame:{BODY_FRAME}": {"visible": True}},
        "topics": {topic.name: {"visible": True} for topic in (BODY, WHEELS, FAULTS)},
        "layers": {},
    } | _title("Satellite")  # fmt: skip


def _vector(path: str, names: Sequence[str], prefix: str, colours: Sequence[str]) -> list[tuple[str, str, str]]:
    return [(f"{path}[{i}]", f"{prefix}{name}", colours[i]) for i, name in enumerate(names)]


def _plot(title: str, lines: Sequence[tuple[str, str, str]]) -> Config:
    return {
        "paths": [
            {
                "value": value, "enabled": True, "timestampMethod": "receiveTime", "label": label, "color": colour,
                "showLine": True, "lineSize": 1,
            }
            for value, label, colour in lines
        ],
        "showLegend": True, "legendDisplay": "floating", "showPlotValuesInLegend": False, "isSynced": True,
        "showXAxisLabels": True, "showYAxisLabels": True, "xAxisVal": "timestamp", "sidebarDimension": 240,
    } | _title(title)  # fmt: skip


def _transitions() -> Config:
    paths = [("/fsw/executive.mode", "mode")]
    paths += [(f'/faults{{unit=="{unit}"}}.phase', unit) for unit in UNITS]
    return {
        "paths": [
            {"value": value, "label": label, "enabled": True, "timestampMethod": "receiveTime"}
            for value, label in paths
        ],
        "isSynced": True,
    } | _title("Mode and faults")  # fmt: skip


def _name(button: Button) -> str:
    return f"CallService!{button.service.strip('/').replace('/', '-')}"


def _call(button: Button) -> Config:
    return {
        "serviceName": button.service, "requestPayload": json.dumps(button.request, indent=2), "layout": "vertical",
        "editingMode": True, "buttonText": button.title, "timeoutSeconds": 10,
        "buttonColor": "#2e7d4f" if button.family == "all" else "#a8322a",
    } | _title(button.title)  # fmt: skip


# -- places --------------------------------------------------------------------------------------------------------


def _fit(config: Config, topics: Collection[str]) -> Config | None:
    """The panel without what the log has not; None when nothing is left of it."""
    for key in ("topicPath", "topicToRender"):
        if key in config and config[key] not in topics:
            return None
    if "paths" in config:
        config = config | {"paths": [line for line in config["paths"] if topic_of(line["value"]) in topics]}
        return config if config["paths"] else None
    if "topics" in config:
        config = config | {"topics": {name: item for name, item in config["topics"].items() if name in topics}}
        return config if config["topics"] else None
    return config


def _split(direction: str, percentage: float, first: Area, second: Area) -> Area:
    return {"direction": direction, "splitPercentage": percentage, "first": first, "second": second}


def _stack(*panels: Area, direction: str = "column") -> Area:
    """Areas that share a place alike."""
    if len(panels) == 1:
        return panels[0]
    return _split(direction, 100.0 / len(panels), panels[0], _stack(*panels[1:], direction=direction))


def _grid(panels: Sequence[str]) -> Area:
    rows = [panels[at : at + COLUMNS] for at in range(0, len(panels), COLUMNS)]
    return _stack(*(_stack(*row, direction="row") for row in rows))


def _prune(area: Area, configs: Collection[str]) -> Area | None:
    """The area without panels that there are not."""
    if isinstance(area, str):
        return area if area in configs else None
    first, second = _prune(area["first"], configs), _prune(area["second"], configs)
    if first is None or second is None:
        return first if second is None else second
    return area | {"first": first, "second": second}
