"""The nodes on the bus with their controllers: who can be heard, who hears, and what errors do to all of them."""

from __future__ import annotations

from plant_server.can_bus.controller import Controller
from plant_server.can_bus.error_frames import (
    BIT,
    BUSERROR,
    IN_CRC,
    IN_DATA,
    PROT,
    SENDING,
    STUFF,
    UNSPECIFIED,
    Reporter,
)
from plant_server.faults.bus_nodes import FSW, NODES

DOMINANT_EIGHTS = 32  # times eight dominant bits, from which on a counter says no more


class Stations:
    """Every node's controller, and the faults that act on controllers on this tick."""

    def __init__(self) -> None:
        self.controllers = {node: Controller() for node in NODES}
        self.reporter = Reporter(self.controllers[FSW])
        self.failing: frozenset[str] = frozenset()  # nodes whose every attempt fails
        self.is_blocked = False  # the bus is held dominant
        self.stays_off: set[str] = set()  # nodes that nobody restarts
        self._was_blocked = False
        self._is_clean = True  # every counter is 0: another good frame changes nothing

    def set_faults(self, failing: frozenset[str], stays_off: frozenset[str], is_blocked: bool) -> None:
        """Take what the faults of this tick do to nodes and bus."""
        self.failing, self.is_blocked = failing, is_blocked
        self.stays_off |= stays_off
        if is_blocked and not self._was_blocked:
            self._is_clean = False
            for controller in self.controllers.values():
                controller.note_hear_error()
                controller.note_dominant(DOMINANT_EIGHTS)
            self.reporter.note_error(PROT | BUSERROR, STUFF, 0)
            self.reporter.look()
        self._was_blocked = is_blocked

    def is_off(self, node: str) -> bool:
        """Whether a node neither sends nor hears."""
        return self.controllers[node].is_off

    def has_listener(self, sender: str) -> bool:
        """Whether any other node is there to acknowledge a frame."""
        if self._is_clean:
            return True
        return any(not item.is_off for node, item in self.controllers.items() if node != sender)

    def note_success(self, sender: str) -> None:
        """A frame of this node went through."""
        if self._is_clean:
            return
        for node, controller in self.controllers.items():
            if node == sender:
                controller.note_sent()
            else:
                controller.note_heard()
        self.reporter.look()
        self._is_clean = not any(item.tec or item.rec for item in self.controllers.values())

    def note_failure(self, sender: str) -> None:
        """An attempt of this node ended in an error frame."""
        self._is_clean = False
        for node, controller in self.controllers.items():
            if node == sender:
                controller.note_send_error()
            else:
                controller.note_hear_error()
        if sender == FSW:
            self.reporter.note_error(PROT | BUSERROR, BIT | SENDING, IN_DATA)
        else:
            self.reporter.note_error(PROT | BUSERROR, UNSPECIFIED, IN_CRC)
        self.reporter.look()

    def note_unacknowledged(self, sender: str) -> None:
        """An attempt of this node was acknowledged by nobody."""
        self._is_clean = False
        self.controllers[sender].note_send_error(only_unacknowledged=True)
        self.reporter.look()

    def note_recessive(self, sequences: int) -> None:
        """So many sequences of 11 recessive bits went by on the bus: nodes that are off and may, come back."""
        if self._is_clean:
            return
        for node, controller in self.controllers.items():
            if controller.is_off and node not in self.failing and node not in self.stays_off:
                controller.note_recessive(sequences)
        self.reporter.look()
