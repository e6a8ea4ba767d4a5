"""The plant as a component of the MAVLink system, polled by its own loop once a tick."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from bus.clock import MonotonicClock
from bus.mavlink import words
from bus.mavlink.component import Component, Identity, Traffic
from bus.mavlink.endpoint import Endpoint
from bus.run import GroundConfig
from plant_server.faults import FaultEvent
from plant_server.ground.command import FailureCommand
from plant_server.ground.desk import FaultDesk
from plant_server.ground.requests import Requests
from plant_server.node import PlantNode
from plant_server.plant_log import describe_event

IDENTITY: Final = Identity(
    words.PLANT_COMPONENT,
    words.TYPE_ONBOARD,
    words.AUTOPILOT_INVALID,
    words.CAN_MAVLINK2 | words.CAN_PARAM_ENCODE_C_CAST | words.CAN_COMMAND_INT,
)
SEVERITIES: Final = {"onset": words.WARNING, "effect": words.WARNING, "end": words.INFO, "cleared": words.INFO}


class PlantGround:
    """What a plant's node has as its `ground`."""

    def __init__(self, node: PlantNode, component: Component, desk: FaultDesk, requests: Requests) -> None:
        self.component = component
        self.desk = desk
        self._node = node
        self._requests = requests

    def poll(self, tick: int) -> None:
        """Take what has come before this tick; commands act from it on."""
        self.component.poll()

    def report(self, events: tuple[FaultEvent, ...]) -> None:
        """Tell everybody what faults have done, whoever commanded them."""
        if not events:
            return
        for event in events:
            self.component.say(SEVERITIES[event.phase], describe_event(event))
        self._requests.report(events)

    def close(self) -> None:
        """Tell those who wait that the run is over, and close the socket. May be repeated."""
        if self._node.ground is self:
            self._node.ground = None
            self._requests.close()
            self.component.close()


def open_ground(
    node: PlantNode, config: GroundConfig, clock: MonotonicClock, *, name: str = "", ticks: int | None = None
) -> PlantGround:
    """Give a plant's node its socket for MAVLink; return that with which it is closed.

    name  : of the run
    ticks : of the whole run; None: it has no end that is known
    Raises UsageError where the socket cannot be made.
    """
    desk = FaultDesk(node, ticks, config.inject)
    requests = Requests(desk, name)
    failures = FailureCommand(desk)
    traffic = Traffic(commands={words.CMD_INJECT_FAILURE: failures.obey})
    endpoint = Endpoint(Path(config.socket), words.SYSTEM_ID, words.PLANT_COMPONENT)
    component = Component(
        endpoint, IDENTITY, clock, lambda: (words.FLAG_HIL, 0, words.STATE_ACTIVE),
        failures.list_parameters(), traffic, requests.take,
    )  # fmt: skip
    failures.component = component
    ground = PlantGround(node, component, desk, requests)
    node.ground = ground
    return ground
