"""A Robotiq 2F-85 through the text protocol of its URCap, on port 63352 of the robot's controller.

A request is one line, ``GET <variable>`` or ``SET <variable> <value> ...``; the answers are ``<variable> <value>`` and
``ack``. The variables and their values are those of Robotiq's manual of the 2F-85 (registers: ACT, GTO, POS, SPE, FOR,
STA, OBJ, FLT).
"""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from typing import Annotated, Final

import numpy as np

from visualrhp.embodiment.robot_cell import GripperState
from visualrhp.errors import CellFault
from visualrhp.parameters import Field, Positive, parameters

PORT: Final = 63352
"""Of the URCap."""

_ACTIVE: Final = 3  # STA: activation is completed
_MOVING: Final = 0  # OBJ: in motion to the commanded position
_FAULTS: Final = {
    5: "it has to be activated before it moves",
    7: "it was not activated",
    8: "it is too hot",
    9: "it does not communicate",
    10: "its supply voltage is low",
    11: "automatic release is in progress",
    12: "an internal fault; its log has more",
    13: "its activation failed",
    14: "its current is too high",
    15: "automatic release is completed; it has to be activated again",
}
_REPORTS_PER_STATUS: Final = 10
"""A request takes some milliseconds; that the gripper is active is asked for in every tenth report."""
_MINOR: Final = (0, 9)
"""FLT: none, and one that ends by itself."""

Byte = Annotated[int, Field(ge=0, le=255)]


@parameters(kw_only=True)
class RobotiqParameters:
    """Parameters of the gripper.

    Attributes:
        port: of its server.
        speed: of the fingers, 0 (20 mm/s) to 255 (150 mm/s).
        force: when they grip, 0 (20 N) to 255 (235 N).
        stroke: distance between the pads when they are open [m].
        open_position, closed_position: what it reports when the pads are open, and when they touch.
        timeout_s: for an answer.
        activation_s: time to be activated [s], in which the fingers move.
    """

    port: Annotated[int, Field(ge=1, le=65535)] = PORT
    speed: Byte = 100
    force: Byte = 20
    stroke: Positive = 0.085
    open_position: Byte = 3
    closed_position: Byte = 228
    timeout_s: Positive = 0.5
    activation_s: Positive = 8.0


class RobotiqGripper:
    """The gripper. Every method raises CellFault if it does not answer, or answers something else than it should.

    Args:
        host: address of the robot's controller.
        settings: see :class:`RobotiqParameters`.
        clock: of the cell [s].
        sleep: lets time pass [s].
    """

    def __init__(
        self,
        host: str,
        settings: RobotiqParameters | None = None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.settings = settings or RobotiqParameters()
        self._clock, self._sleep = clock, sleep
        self._where = f"the gripper at {host}:{self.settings.port}"
        self._buffer = b""
        self._num_reports, self._is_going = 0, False
        try:
            self._socket = socket.create_connection((host, self.settings.port), self.settings.timeout_s)
        except OSError as error:
            raise CellFault(
                f"{self._where} cannot be reached ({error}); its URCap serves it while the controller is switched on"
            ) from error

    def activate(self) -> None:
        """Activate the gripper, which opens and closes its fingers, if it is not active."""
        if self._get("STA") == _ACTIVE and self._get("ACT") == 1:
            return
        self._set({"ACT": 0})
        self._set({"ACT": 1})
        end = self._clock() + self.settings.activation_s
        while self._get("STA") != _ACTIVE:
            if self._clock() > end:
                raise CellFault(f"{self._where} is not active {self.settings.activation_s:g} s after it was told to be")
            self._sleep(0.05)

    def move(self, opening: float) -> None:
        """Start moving the fingers to ``opening`` [m], until they hold something."""
        settings = self.settings
        part = min(max(opening / settings.stroke, 0.0), 1.0)
        position = settings.closed_position + part * (settings.open_position - settings.closed_position)
        if part == 0.0:
            position = 255.0  # as far as they go, whatever the calibration
        self._set({"POS": round(position), "SPE": settings.speed, "FOR": settings.force, "GTO": 1})
        self._is_going = True

    def stop(self) -> None:
        """Stop the fingers where they are."""
        self._set({"GTO": 0})
        self._is_going = False

    def state(self) -> GripperState:
        """The state of the gripper."""
        settings = self.settings
        position, status, fault = self._get("POS"), self._get("OBJ"), self._get("FLT")
        closed, opened = settings.closed_position, settings.open_position
        opening = float(np.clip((closed - position) / (closed - opened), 0.0, 1.0)) * settings.stroke
        problem = None
        if fault not in _MINOR:
            problem = _FAULTS.get(fault, f"fault {fault}")
        elif self._num_reports % _REPORTS_PER_STATUS == 0 and self._get("STA") != _ACTIVE:
            problem = "it is not active"
        self._num_reports += 1
        return GripperState(opening, status == _MOVING and self._is_going, self._clock(), problem)

    def close(self) -> None:
        """Close the connection; closing twice has no effect."""
        self._socket.close()

    def _get(self, variable: str) -> int:
        answer = self._ask(f"GET {variable}")
        name, _, value = answer.partition(" ")
        if name != variable or not value.strip().lstrip("-").isdigit():
            raise CellFault(f"{self._where} answered {answer!r:.60} to GET {variable}")
        return int(value)

    def _set(self, values: dict[str, int]) -> None:
        text = " ".join(f"{name} {value}" for name, value in values.items())
        answer = self._ask(f"SET {text}")
        if answer != "ack":
            raise CellFault(f"{self._where} answered {answer!r:.60} to SET {text}")

    def _ask(self, request: str) -> str:
        try:
            self._socket.sendall(request.encode("ascii") + b"\n")
            return self._line()
        except OSError as error:
            raise CellFault(f"{self._where} does not answer {request} ({error})") from error

    def _line(self) -> str:
        """The next answer: a line, or ``ack``, which some versions send without a line break."""
        while b"\n" not in self._buffer and self._buffer.strip() != b"ack":
            received = self._socket.recv(1024)
            if not received:
                raise OSError("the connection was closed")
            self._buffer += received
        line, _, self._buffer = self._buffer.partition(b"\n")
        return line.decode("ascii", errors="replace").strip()
