"""`vcan status`, `up` and `down` with a host made up for the test: each says what is missing and what to do."""

from __future__ import annotations

import errno
import json
import os

import pytest

from bus.errors import UsageError
from bus.wire import rtnetlink
from tools.vcan import diagnosis, interfaces, native, status
from tools.vcan.errors import VcanError

VCAN0 = rtnetlink.Link(index=4, name="vcan0", kind="vcan", mtu=72, is_can=True, is_up=True)
CAN0 = rtnetlink.Link(index=5, name="can0", kind="can", mtu=16, is_can=True, is_up=False)
LO = rtnetlink.Link(index=1, name="lo", kind="", mtu=65536, is_can=False, is_up=True)
NO_CAN = "this kernel has no CAN (AF_CAN is not supported)"


def probes(obstacle: str | None, *, admin: bool = True, backends: dict[str, str | None] | None = None) -> status.Probes:
    found = backends or {"native": obstacle, "uml": None, "qemu": "no qemu"}
    return status.Probes(
        can_obstacle=lambda: obstacle,
        advise=lambda reason: [f"advice for: {reason}"],
        net_admin=lambda: admin,
        links=lambda: [LO, VCAN0, CAN0],
        kernel=lambda: {"built": False, "path": "/c/k", "cost": "5 minutes"},
        obstacles=tuple((name, lambda reason=reason: reason) for name, reason in found.items()),
        notes=lambda name: f"note on {name}",
    )


def test_a_kernel_without_can_is_told_apart_and_the_way_out_is_named() -> None:
    """What is missing comes first, what to do second, and exec falls to the first backend that works."""
    found = status.collect_status(probes(NO_CAN))
    assert found.has_can is False
    assert found.may_make_interfaces is False
    assert found.missing == [NO_CAN, f"advice for: {NO_CAN}"]
    assert found.exec_backend == "uml"
    text = status.as_text(found)
    assert "uml         works (exec takes this one): note on uml" in text
    assert "qemu        no: no qemu" in text
    assert "hilsat vcan kernel build" in text


def test_a_kernel_with_can_but_no_rights_names_the_right() -> None:
    """CAN sockets work for everyone; making an interface takes CAP_NET_ADMIN."""
    found = status.collect_status(probes(None, admin=False))
    assert found.has_can is True
    assert found.may_make_interfaces is False
    assert len(found.missing) == 1
    assert "CAP_NET_ADMIN" in found.missing[0]


def test_a_complete_host_misses_nothing_and_lists_can_interfaces_only() -> None:
    """lo is no CAN interface; a real adapter that is down is listed as such."""
    found = status.collect_status(probes(None))
    assert found.missing == []
    assert found.exec_backend == "native"
    assert [link.name for link in found.interfaces] == ["vcan0", "can0"]
    assert "can0 (can): down, MTU 16" in status.as_text(found)
    assert json.loads(json.dumps(status.as_record(found)))["interfaces"][0]["is_up"] is True


def test_no_backend_at_all_is_an_empty_choice() -> None:
    """Nothing is promised where nothing works."""
    found = status.collect_status(probes(NO_CAN, backends={"native": "a", "uml": "b", "qemu": "c"}))
    assert found.exec_backend == ""


@pytest.mark.parametrize(
    ("options", "files", "words"),
    [
        ({"CONFIG_NET": "y"}, [], "built without CONFIG_CAN, CONFIG_CAN_RAW, CONFIG_CAN_VCAN"),
        ({"CONFIG_CAN": "m", "CONFIG_CAN_RAW": "m"}, ["can", "can-raw"], "built without CONFIG_CAN_VCAN"),
        ({}, ["can", "can-raw", "vcan"], "modprobe -a can can-raw vcan"),
        (
            {"CONFIG_CAN": "m", "CONFIG_CAN_RAW": "m", "CONFIG_CAN_VCAN": "m"},
            [],
            f"linux-modules-extra-{os.uname().release}",
        ),
        ({}, ["can"], "no module can-raw, vcan below"),
    ],
)
def test_advice_tells_kernel_option_module_file_and_loading_apart(
    options: dict[str, str], files: list[str], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three different faults with three different cures; the guest is offered with each."""
    monkeypatch.setattr(diagnosis, "read_kernel_options", lambda release: options)
    monkeypatch.setattr(diagnosis, "find_module_files", lambda release: dict.fromkeys(files, "x"))
    advice = diagnosis.advise("this kernel has no CAN")
    assert words in advice[0]
    assert "hilsat vcan exec" in advice[-1]


def test_up_without_can_names_the_interface_and_the_way_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """The message starts with what was asked for."""
    monkeypatch.setattr(native, "socket_obstacle", lambda: NO_CAN)
    with pytest.raises(VcanError, match="vcan0, vcan1: this kernel has no CAN") as caught:
        interfaces.bring_up(["vcan0", "vcan1"])
    assert caught.value.exit_code == 3
    assert "hilsat vcan exec" in str(caught.value)


def test_up_makes_only_what_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """An interface that is up is left alone; one that is missing is made."""
    made: list[str] = []
    monkeypatch.setattr(native, "socket_obstacle", lambda: None)
    monkeypatch.setattr(rtnetlink, "list_links", lambda: [LO, VCAN0])
    monkeypatch.setattr(rtnetlink, "add_vcan", made.append)
    assert interfaces.bring_up(["vcan0", "vcan7"]) == ["vcan0: is up already (vcan)", "vcan7: made and switched on"]
    assert made == ["vcan7"]


def test_real_adapters_and_foreign_names_are_not_touched(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bit rate is the user's to choose, and an adapter is not ours to remove."""
    monkeypatch.setattr(native, "socket_obstacle", lambda: None)
    eth0 = rtnetlink.Link(index=2, name="eth0", kind="", mtu=1500, is_can=False, is_up=True)
    monkeypatch.setattr(rtnetlink, "list_links", lambda: [LO, CAN0, eth0])
    with pytest.raises(VcanError, match="ip link set can0 up type can bitrate 500000"):
        interfaces.bring_up(["can0"])
    with pytest.raises(UsageError, match="eth0 is there and is not a CAN interface"):
        interfaces.bring_up(["eth0"])
    with pytest.raises(UsageError, match="can0 is not a vcan interface"):
        interfaces.take_down(["can0"])


@pytest.mark.parametrize(("number", "words"), [(errno.EPERM, "CAP_NET_ADMIN"), (errno.EOPNOTSUPP, "vcan driver")])
def test_a_refusal_of_the_kernel_is_explained(number: int, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lack of privilege and lack of the driver are different faults."""

    def refuse(name: str) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(native, "socket_obstacle", lambda: None)
    monkeypatch.setattr(rtnetlink, "list_links", lambda: [])
    monkeypatch.setattr(rtnetlink, "add_vcan", refuse)
    with pytest.raises(VcanError, match=words):
        interfaces.bring_up(["vcan0"])
