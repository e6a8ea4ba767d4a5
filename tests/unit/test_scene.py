"""The scene that a run leaves in its log: sound for every reader, true to the run, and nothing that a verdict depends on."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove import messages
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation

from tools.cli import main
from tools.foxglove.scene import turn_to
from tools.log.mcap_reader import Run, read_run

SHORT = [
    "--duration", "6", "--set", "expect=[]", "--set",
    "faults=[{unit: wheel.2, kind: dead, at_s: 2, until_s: 4}, {unit: gyro.x, kind: constant, rate_rad_s: 0.1, at_s: 3}]",
]  # fmt: skip


def fly(out: Path, *words: str) -> Path:
    """A short run with two faults."""
    done = main(
        ["run", "zhang2018-flight", "--clock", "inprocess", "--no-plot", "-q", *SHORT, *words, "--out", str(out)]
    )
    assert done == 0
    return out / "run.mcap"


@pytest.fixture(scope="module")
def with_scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fly(tmp_path_factory.mktemp("scene") / "with")


@pytest.fixture(scope="module")
def without(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fly(tmp_path_factory.mktemp("scene") / "without", "--no-scene")


def parse(run: Run, topic: str) -> Iterator[tuple[float, dict[str, Any]]]:
    """Time [s] and content of every message."""
    for record in run.iterate(topic):
        yield record.t_ns / 1e9, json.loads(record.data)


# -- the file ------------------------------------------------------------------------------------------------------


def test_another_reader_reads_it_whole_and_in_order(with_scene: Path) -> None:
    """The mcap library's own reader, by the indexes and with checksums: every message that the statistics count, by time."""
    with open(with_scene, "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        found: Counter[str] = Counter()
        times = []
        for schema, channel, message in reader.iter_messages():
            found[channel.topic] += 1
            times.append(message.log_time)
            if channel.topic.startswith("/scene/"):
                assert schema is not None
                assert schema.encoding == "jsonschema"
        names = [attachment.name for attachment in reader.iter_attachments()]
    assert summary is not None
    assert summary.statistics is not None
    counted = {
        summary.channels[number].topic: count
        for number, count in summary.statistics.channel_message_counts.items() if count
    }  # fmt: skip
    assert found == counted
    assert times == sorted(times)
    assert found["/scene/frames"] == 30  # five a second
    assert names.count("grade.json") == 1


def test_nothing_that_is_judged_depends_on_it(
    with_scene: Path, without: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Digest, diff, grade and replay are those of the run without; info counts it; csv of all topics leaves it out."""
    a, b = read_run(with_scene), read_run(without)
    assert a.digest() == b.digest()
    assert not any(name.startswith("/scene/") for name in b.topics)
    assert main(["diff", str(with_scene), str(without)]) == 0
    assert main(["grade", str(with_scene)]) == 0
    assert main(["replay", str(with_scene)]) == 0
    capsys.readouterr()
    assert main(["info", str(with_scene), "--json"]) == 0
    info = json.loads(capsys.readouterr().out)
    assert info["topics"]["/scene/frames"] == 30
    assert info["missing"] == []
    assert main(["export", str(with_scene), "--to", "csv", "-o", str(tmp_path / "all")]) == 0
    names = {path.name for path in (tmp_path / "all").iterdir()}
    assert "truth.attitude.csv" in names
    assert not any(name.startswith("scene") for name in names)
    out = tmp_path / "wheels.csv"
    assert main(["export", str(with_scene), "--to", "csv", "--topic", "/scene/wheels", "-o", str(out)]) == 0
    assert out.stat().st_size > 0


def test_a_log_without_gets_a_copy_with_one(
    with_scene: Path, without: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`export --to scene` makes the same scene; the log stays; one that has it, and one that was cut, are refused."""
    before = without.read_bytes()
    out = tmp_path / "copy.mcap"
    assert main(["export", str(without), "--to", "scene", "-o", str(out)]) == 0
    assert without.read_bytes() == before
    a, b = read_run(with_scene), read_run(out)
    for topic in ("/scene/frames", "/scene/body", "/scene/wheels", "/scene/faults"):
        assert a.payloads(topic) == b.payloads(topic), topic
    assert a.digest() == b.digest()
    assert main(["export", str(out), "--to", "scene", "-o", str(tmp_path / "again.mcap")]) == 2
    assert "has a scene already" in capsys.readouterr().err
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(before[:-2000])
    assert main(["export", str(cut), "--to", "scene", "-o", str(tmp_path / "again.mcap")]) == 3
    assert "hilsat recover" in capsys.readouterr().err
    assert not (tmp_path / "again.mcap").exists()


# -- what is seen --------------------------------------------------------------------------------------------------


def build(kind: str, value: Any) -> Any:
    """A message of the SDK's own class: it refuses a field that the schema has not."""
    if kind == "Timestamp":
        return messages.Timestamp(sec=value["sec"], nsec=value["nsec"])
    if kind == "Duration":
        return messages.Duration(sec=value["sec"], nsec=value["nsec"])
    inner = {
        "timestamp": "Timestamp", "lifetime": "Duration", "pose": "Pose", "position": "Vector3", "size": "Vector3",
        "translation": "Vector3", "orientation": "Quaternion", "rotation": "Quaternion", "color": "Color",
        "entities": "SceneEntity", "deletions": "SceneEntityDeletion", "arrows": "ArrowPrimitive",
        "cubes": "CubePrimitive", "cylinders": "CylinderPrimitive", "texts": "TextPrimitive",
        "metadata": "KeyValuePair", "transforms": "FrameTransform",
    }  # fmt: skip
    arguments = {}
    for name, item in value.items():
        if isinstance(item, list):
            arguments[name] = [build(inner[name], part) for part in item]
        else:
            arguments[name] = build(inner[name], item) if isinstance(item, dict) else item
    return getattr(messages, kind)(**arguments)


def test_messages_are_those_of_foxglove(with_scene: Path) -> None:
    """Every field has the name and type that Foxglove's SDK knows, and every time stamp is the message's own time."""
    run = read_run(with_scene)
    for topic, info in run.topics.items():
        if topic.startswith("/scene/"):
            for t_s, data in parse(run, topic):
                assert build(info.schema_name.removeprefix("foxglove."), data) is not None
                for part in data.get("transforms", data.get("entities")):
                    assert part["timestamp"]["sec"] + part["timestamp"]["nsec"] / 1e9 == pytest.approx(t_s, abs=1e-9)


def test_every_field_is_in_the_schema(with_scene: Path) -> None:
    """The schema in the log describes all that its messages hold, down to the last number."""

    def check(schema: dict[str, Any], value: Any) -> None:
        if isinstance(value, dict):
            assert value.keys() <= schema["properties"].keys()
            for name, item in value.items():
                check(schema["properties"][name], item)
        elif isinstance(value, list):
            assert schema["type"] == "array"
            for item in value:
                check(schema["items"], item)
        else:
            kinds = {"number": (int, float), "integer": int, "string": str, "boolean": bool}
            assert isinstance(value, kinds[schema["type"]])

    run = read_run(with_scene)
    for topic, info in run.topics.items():
        if topic.startswith("/scene/"):
            for _, data in parse(run, topic):
                check(json.loads(info.schema), data)


def test_the_body_turns_as_the_truth_does(with_scene: Path) -> None:
    """Each rotation is that of the truth at that time, as scipy understands both."""
    run = read_run(with_scene)
    truth = dict(zip(run.t_ns("/truth/attitude").tolist(), run.signals("/truth/attitude")["q_ib"], strict=True))
    for record in run.iterate("/scene/frames"):
        q = json.loads(record.data)["transforms"][0]["rotation"]
        shown = Rotation.from_quat([q["x"], q["y"], q["z"], q["w"]])
        w, x, y, z = truth[record.t_ns]
        assert (shown.inv() * Rotation.from_quat([x, y, z, w])).magnitude() < 1e-5


def test_wheels_stand_on_their_true_axes(with_scene: Path) -> None:
    """Each disc's axis is off its nominal one by the tilt of the scenario: 10, 8 and 5 degrees, the skew one more than 5."""
    run = read_run(with_scene)
    _, data = next(parse(run, "/scene/wheels"))
    nominal = [*np.eye(3), np.ones(3) / np.sqrt(3.0)]
    angles = []
    for entity, axis in zip(data["entities"], nominal, strict=True):
        q = entity["cylinders"][0]["pose"]["orientation"]
        disc = Rotation.from_quat([q["x"], q["y"], q["z"], q["w"]]).apply([0.0, 0.0, 1.0])
        place = np.array([entity["cylinders"][0]["pose"]["position"][part] for part in "xyz"])
        assert np.cross(place, disc) == pytest.approx(np.zeros(3), abs=1e-3)
        angles.append(np.degrees(np.arccos(min(1.0, float(disc @ axis)))))
    assert angles[:3] == pytest.approx([10.0, 8.0, 5.0], abs=0.02)
    assert angles[3] > 5.0


def test_what_is_broken_is_red_and_named_while_it_is(with_scene: Path) -> None:
    """Wheel 2 is red from its onset to its end and no other ever is; the words follow."""
    run = read_run(with_scene)
    for t_s, data in parse(run, "/scene/wheels"):
        red = [e["id"] for e in data["entities"] if e["cylinders"][0]["color"]["r"] > 0.5]
        assert red == (["wheel.2"] if 2.0 <= t_s < 4.0 else []), t_s
    words = [
        (t_s, [text["text"] for e in data["entities"] for text in e["texts"]])
        for t_s, data in parse(run, "/scene/faults")
    ]
    assert words == [
        (0.0, []),
        (2.0, ["wheel.2: dead"]),
        (3.0, ["gyro.x: constant", "wheel.2: dead"]),
        (4.0, ["gyro.x: constant"]),
    ]


def test_a_disc_is_as_thick_as_its_torque(with_scene: Path) -> None:
    """Thickness rises with the torque at that time, from a thin disc at rest; an arrow shows which way."""
    run = read_run(with_scene)
    tau = dict(zip(run.t_ns("/truth/wheels").tolist(), run.signals("/truth/wheels")["tau_rw_true_nm"], strict=True))
    seen = 0
    for record in run.iterate("/scene/wheels"):
        for entity, torque in zip(json.loads(record.data)["entities"], tau[record.t_ns], strict=True):
            share = min(1.0, abs(torque) / 0.1)
            assert entity["cylinders"][0]["size"]["z"] == pytest.approx(0.04 + 0.16 * share, abs=0.002)
            if share > 0.02:
                q = entity["arrows"][0]["pose"]["orientation"]
                way = Rotation.from_quat([q["x"], q["y"], q["z"], q["w"]]).apply([1.0, 0.0, 0.0])
                place = np.array([entity["cylinders"][0]["pose"]["position"][part] for part in "xyz"])
                assert np.sign(way @ place) == np.sign(torque)
                seen += 1
    assert seen > 10


def test_turning_takes_one_direction_to_another() -> None:
    """Against scipy, for random directions and for opposite ones."""
    generator = np.random.default_rng(2)
    pairs = [*generator.normal(size=(50, 2, 3)), *(np.array([v, -v]) for v in np.eye(3))]
    for start, end in pairs:
        start, end = start / np.linalg.norm(start), end / np.linalg.norm(end)
        w, x, y, z = turn_to(end.tolist(), start.tolist())
        assert Rotation.from_quat([x, y, z, w]).apply(start) == pytest.approx(end, abs=1e-9)
