"""A controller, a gripper and a camera that speak the protocols of the real ones, and can fail.

The gripper is a server on the loopback interface with the text protocol of Robotiq's URCap. The two interfaces of
``ur_rtde`` are objects with its methods; the arm takes the positions that it is commanded.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from types import SimpleNamespace

import numpy as np

NORMAL, RUNNING = 1, 7


class FakeController:
    """The arm, and what ``rtde_receive`` and ``rtde_control`` show of it.

    Attributes:
        calls: names of the commands, in order.
        targets: positions that were commanded.
        refuses: whether ``servoJ`` is refused.
        breaks: an error that every call of the control interface raises; None for none.
        is_frozen: whether its clock and its reports stand still.
    """

    def __init__(self) -> None:
        self.positions = [0.0, -1.5, 1.5, -1.5, -1.5, 0.0]
        self.velocities = [0.0] * 6
        self.robot_mode, self.safety_mode = RUNNING, NORMAL
        self.is_connected, self.refuses, self.is_frozen = True, False, False
        self.breaks: Exception | None = None
        self.cannot_connect = False
        self.calls: list[str] = []
        self.targets: list[list[float]] = []
        self.frequencies: list[float] = []
        self._frozen_at = 0.0

    def timestamp(self) -> float:
        """Its own clock, 1,000 s ahead of this machine's."""
        if not self.is_frozen:
            self._frozen_at = time.monotonic() + 1000.0
        return self._frozen_at

    def modules(self, name: str):
        """In place of ``importlib.import_module``."""
        interface = {
            "rtde_receive": ("RTDEReceiveInterface", _Receive),
            "rtde_control": ("RTDEControlInterface", _Control),
        }
        attribute, kind = interface[name]

        def connect(host, frequency):
            if self.cannot_connect:
                raise RuntimeError("connect: Connection refused")
            self.frequencies.append(frequency)
            return kind(self)

        return SimpleNamespace(**{attribute: connect})


class _Receive:
    def __init__(self, controller: FakeController) -> None:
        self.of = controller

    def isConnected(self):
        return self.of.is_connected

    def getRobotMode(self):
        return self.of.robot_mode

    def getSafetyMode(self):
        return self.of.safety_mode

    def getTimestamp(self):
        return self.of.timestamp()

    def getActualQ(self):
        return list(self.of.positions)

    def getActualQd(self):
        return list(self.of.velocities)

    def disconnect(self):
        self.of.calls.append("receive.disconnect")


class _Control:
    def __init__(self, controller: FakeController) -> None:
        self.of = controller

    def _call(self, name):
        self.of.calls.append(name)
        if self.of.breaks is not None:
            raise self.of.breaks

    def initPeriod(self):
        return time.monotonic()

    def waitPeriod(self, begun):
        time.sleep(max(0.0, begun + 1.0 / self.of.frequencies[-1] - time.monotonic()))

    def servoJ(self, q, speed, acceleration, period, lookahead, gain):
        assert len(q) == 6 and speed == acceleration == 0.0 and 0.03 <= lookahead <= 0.2 and 100 <= gain <= 2000
        self._call("servoJ")
        if self.of.refuses:
            return False
        self.of.targets.append(list(q))
        self.of.positions = list(q)
        return True

    def servoStop(self, deceleration):
        self._call("servoStop")
        return True

    def stopJ(self, deceleration):
        self._call("stopJ")

    def stopScript(self):
        self._call("stopScript")

    def disconnect(self):
        self._call("control.disconnect")


class FakeGripper:
    """The server of the gripper.

    Attributes:
        variables: its registers.
        requests: the lines that it received.
        answer: changes an answer: a function of (request, answer).
        line_end: after every answer; some versions have none after ``ack``.
    """

    def __init__(self) -> None:
        self.variables = {"ACT": 0, "GTO": 0, "STA": 0, "OBJ": 3, "FLT": 0, "POS": 3, "SPE": 0, "FOR": 0}
        self.requests: list[str] = []
        self.answer = lambda request, answer: answer
        self.line_end = b"\n"
        self.holds_at: int | None = None
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        try:
            connection, _ = self._server.accept()
            with connection, connection.makefile("rb") as lines:
                for line in lines:
                    request = line.decode("ascii").strip()
                    self.requests.append(request)
                    answer = self.answer(request, self._reply(request))
                    if answer is None:
                        return
                    connection.sendall(answer.encode() + self.line_end)
        except OSError:
            return

    def _reply(self, request: str) -> str:
        verb, *words = request.split()
        if verb == "GET":
            return f"{words[0]} {self.variables[words[0]]}"
        new = dict(zip(words[::2], map(int, words[1::2]), strict=True))
        self.variables |= new
        if "ACT" in new:
            self.variables["STA"] = 3 if new["ACT"] else 0
        if "POS" in new:
            self.variables["OBJ"] = 3
            if self.holds_at is not None and new["POS"] > self.holds_at:
                self.variables |= {"POS": self.holds_at, "OBJ": 2}
        return "ack"

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)  # a thread that waits for a connection keeps the port open
        self._server.close()


class FakeCapture:
    """A device of OpenCV: BGR images, one every 5 ms.

    Attributes:
        size: width and height [px].
        fails_after: number of images, after which it gives none.
        error: that ``read`` raises then; None to return that there is no image.
        is_still: whether the images differ by noise only, as of a scene at rest.
    """

    def __init__(self, size=(64, 48), fails_after=10**9, error=None, is_open=True, is_still=False) -> None:
        self.is_still, self._rng = is_still, np.random.default_rng(0)
        self.size, self.fails_after, self.error, self.is_open = size, fails_after, error, is_open
        self.num_read, self.settings = 0, {}
        self.is_released = False

    def isOpened(self):
        return self.is_open

    def set(self, key, value):
        self.settings[key] = value
        return True

    def read(self):
        time.sleep(0.005)
        if self.num_read >= self.fails_after:
            if self.error is not None:
                raise self.error
            return False, None
        self.num_read += 1
        width, height = self.size
        if self.is_still:
            stripes = np.where(np.arange(width) % 16 < 8, 60, 180)[None, :, None]
            return True, (stripes + self._rng.integers(-3, 4, (height, width, 3))).astype(np.uint8)
        image = np.zeros((height, width, 3), np.uint8)
        image[..., 0], image[..., 2] = 200, self.num_read % 256  # blue, and the number in red
        return True, image

    def release(self):
        self.is_released = True
