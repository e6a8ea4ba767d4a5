"""Addresses: what each names, and what is said when one names nothing."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from bus.errors import BusAddressError
from bus.wire import can_link
from bus.wire.address import open_transport
from bus.wire.rtnetlink import Link, parse_link, split_messages

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("vcan0", "did you mean socketcan:vcan0?"),
        ("/tmp/bench", "did you mean hub:/tmp/bench?"),
        ("hbu:/tmp/b", "did you mean hub:/tmp/b?"),
        ("sockectan:can0", "did you mean socketcan:can0?"),
        ("kvasre:0", "did you mean kvaser:0?"),
        ("memory", "did you mean memory:<where>?"),
        ("nonsense", "There are: memory:<name>, hub:<dir>, socketcan:<interface>"),
        ("hilsat:x", "pcan"),
    ],
)
def test_an_unknown_address_lists_what_there_is_and_guesses(address: str, words: str) -> None:
    with pytest.raises(BusAddressError) as caught:
        open_transport(address, node="x")
    assert words in str(caught.value)
    assert f'"{address}"' in str(caught.value)
    assert caught.value.exit_code == 2


def test_a_queue_needs_room_for_a_frame() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        open_transport("memory:x", node="x", queue_frames=0)


def test_our_own_transports_do_not_load_python_can(tmp_path: Path) -> None:
    """Its import costs more than the rest of the start together."""
    code = (
        "import sys; from bus.wire.address import open_transport; open_transport('memory:x', node='a')\n"
        f"open_transport('hub:{tmp_path}/b', node='a', host=True)\n"
        "from bus.errors import BusError, BusAddressError\n"
        "try: open_transport('socketcan:nothing0', node='a')\n"
        "except BusAddressError: pass\n"
        "sys.exit('can' in sys.modules)"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    assert subprocess.run([sys.executable, "-P", "-c", code], env=environment).returncode == 0


class TestCanInterfaces:
    """Run anywhere: `lo` is on every Linux, and whether the kernel has CAN is told to the code, not asked."""

    def test_a_kernel_without_can_is_named_with_the_ways_out(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(can_link, "kernel_has_can", lambda: False)
        with pytest.raises(BusAddressError) as caught:
            open_transport("socketcan:vcan0", node="x")
        assert str(caught.value) == (
            "vcan0 is not there (this kernel has no CAN); use --bus hub: or run inside `hilsat vcan exec`"
        )

    def test_a_missing_interface_lists_the_others(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(can_link, "kernel_has_can", lambda: True)
        monkeypatch.setattr(can_link, "list_can_links", lambda: ["can7", "vcan3"])
        with pytest.raises(BusAddressError, match=r"vcan33 is not there; did you mean vcan3\? there are: can7, vcan3"):
            open_transport("socketcan:vcan33", node="x")
        monkeypatch.setattr(can_link, "list_can_links", list)
        with pytest.raises(BusAddressError, match="hilsat vcan up"):
            open_transport("socketcan:vcan33", node="x")

    def test_an_interface_that_is_not_can(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(can_link, "kernel_has_can", lambda: True)
        with pytest.raises(BusAddressError, match="lo is not a CAN interface"):
            open_transport("socketcan:lo", node="x")

    @pytest.mark.parametrize("name", ["", "a name longer than any interface", "with/slash", "nul\0"])
    def test_names_that_no_interface_can_have(self, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
        monkeypatch.setattr(can_link, "kernel_has_can", lambda: True)
        with pytest.raises(BusAddressError, match="is not there"):
            open_transport(f"socketcan:{name}", node="x")

    def test_down_and_at_another_bit_rate(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """What the kernel says of the interface decides; each refusal holds the command that mends it."""
        link = Link(index=3, name="can0", kind="can", mtu=16, is_can=True, is_up=True, bitrate_bps=250_000)
        monkeypatch.setattr(can_link, "kernel_has_can", lambda: True)
        monkeypatch.setattr(can_link, "find_link", lambda name: replace(link, is_up=False))
        with pytest.raises(BusAddressError, match=r"can0 is down; .* ip link set can0 up"):
            can_link.check_link("can0", 500_000)
        monkeypatch.setattr(can_link, "find_link", lambda name: link)
        with pytest.raises(BusAddressError, match=r"can0 runs at 250000 bit/s, .* 500000 bit/s; .* bitrate 500000"):
            can_link.check_link("can0", 500_000)
        assert can_link.check_link("can0", 250_000).bitrate_bps == 250_000

    def test_the_bit_rate_is_found_in_the_kernels_answer(self) -> None:
        """An RTM_NEWLINK message laid out by hand from linux/rtnetlink.h and linux/can/netlink.h."""

        def attribute(kind: int, payload: bytes) -> bytes:
            length = 4 + len(payload)
            return length.to_bytes(2, sys.byteorder) + kind.to_bytes(2, sys.byteorder) + payload + bytes(-length % 4)

        def read_bitrates(data: bytes) -> list[int | None]:
            bodies = (body for _, body in split_messages(data) if len(body) >= 16)
            return [parse_link(body).bitrate_bps for body in bodies]

        def word(value: int) -> bytes:
            return value.to_bytes(4, sys.byteorder)

        bittiming = word(500_000) + word(875) + bytes(24)  # struct can_bittiming: bitrate, sample point, six more
        data = attribute(2, word(8_000_000)) + attribute(1, bittiming)  # IFLA_CAN_CLOCK, IFLA_CAN_BITTIMING
        info = attribute(1, b"can\0") + attribute(2, data)  # IFLA_INFO_KIND, IFLA_INFO_DATA
        link = attribute(3, b"can0\0") + attribute(18, info)  # IFLA_IFNAME, IFLA_LINKINFO
        header = word(32 + len(link)) + (16).to_bytes(2, sys.byteorder) + bytes(10)  # struct nlmsghdr
        ifinfomsg = bytes(2) + (280).to_bytes(2, sys.byteorder) + bytes(12)  # struct ifinfomsg of an ARPHRD_CAN
        message = header + ifinfomsg + link
        assert read_bitrates(message) == [500_000]
        plain = attribute(3, b"vcan0\0")
        header = word(32 + len(plain)) + (16).to_bytes(2, sys.byteorder) + bytes(10)
        assert read_bitrates(header + ifinfomsg + plain) == [None]
        for cut in range(len(message)):
            assert read_bitrates(message[:cut]) in ([], [None], [500_000])
