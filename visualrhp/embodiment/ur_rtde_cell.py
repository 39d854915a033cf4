"""A real cell: a UR5e through RTDE (package ``ur_rtde``), a Robotiq 2F-85 and a camera (docs/your_own_robot.md).

Complete but for the hardware: tested with a controller, a gripper and a camera that speak the same protocols. It is not
a safety function. The emergency stop, the safety planes and the speed limits of the controller have to be set up, and
hold whatever this program does.
"""

from __future__ import annotations

import importlib
import math
import threading
import time
from collections.abc import Callable
from typing import Annotated, Any, Final, Protocol

import numpy as np

from visualrhp.embodiment.opencv_camera import OpenCvCamera, OpenCvParameters
from visualrhp.embodiment.robot_cell import NUM_JOINTS, ArmState, CameraFrame, GripperState, JointTrajectory, RobotCell
from visualrhp.embodiment.robotiq_gripper import RobotiqGripper, RobotiqParameters
from visualrhp.errors import CellFault, ConfigError
from visualrhp.parameters import Field, Positive, parameters

SAFETY_MODES: Final = {
    1: None,  # normal
    2: None,  # reduced
    3: "a protective stop: unlock it at the teach pendant",
    4: "recovery mode: move the arm back into its limits at the teach pendant",
    5: "a safeguard stop: close the gate, or leave the scanner's field",
    6: "an emergency stop of the system",
    7: "an emergency stop of the robot",
    8: "a violation of a safety limit",
    9: "a fault of the safety system",
    10: "a validation of the joints is needed",
    11: "the safety mode is undefined",
}
"""What RTDE's output ``safety_mode`` means (Universal Robots, RTDE guide); None if the robot may move."""

_RUNNING: Final = 7  # robot_mode: brakes released, in operation
_HOLD_S: Final = 0.1  # for which the last position is commanded


@parameters(kw_only=True)
class UrRtdeParameters:
    """Parameters of the cell.

    Attributes:
        host: address of the robot's controller.
        frequency: of the commands [Hz]; a UR5e takes 500.
        lookahead_s: of ``servoJ``, which smooths the motion (0.03 to 0.2 s).
        gain: of ``servoJ`` (100 to 2000).
        deceleration: with which the arm is stopped [rad/s^2].
        heartbeat_s: the arm is stopped if nobody has asked for its state for so long while it moves.
        gripper: see :class:`~visualrhp.embodiment.robotiq_gripper.RobotiqParameters`.
        camera: see :class:`~visualrhp.embodiment.opencv_camera.OpenCvParameters`.
    """

    host: str
    frequency: Annotated[float, Field(ge=10.0, le=500.0)] = 500.0
    lookahead_s: Annotated[float, Field(ge=0.03, le=0.2)] = 0.05
    gain: Annotated[float, Field(ge=100.0, le=2000.0)] = 400.0
    deceleration: Positive = 8.0
    heartbeat_s: Positive = 0.25
    gripper: RobotiqParameters = Field(default_factory=RobotiqParameters)
    camera: OpenCvParameters = Field(default_factory=OpenCvParameters)

    def __post_init__(self) -> None:
        if not self.host.strip():
            raise ValueError("host is empty: it should be the address of the robot's controller, such as 192.168.1.10.")


class Camera(Protocol):
    """Gives frames."""

    def frame(self) -> CameraFrame: ...
    def close(self) -> None: ...


class UrRtdeCell(RobotCell):
    """The cell.

    Args:
        settings: see :class:`UrRtdeParameters`.
        read_only: whether nothing can be commanded (a dry run): only the outputs of the controller are read.
        clock, sleep: of this machine [s].
        import_module: imports ``rtde_receive`` and ``rtde_control``; tests give their own.
        open_camera: opens the camera.

    Raises:
        ConfigError: the package ``ur_rtde`` is not installed, or the camera cannot be opened.
        CellFault: the controller or the gripper cannot be reached, or is not ready.
    """

    def __init__(
        self,
        settings: UrRtdeParameters,
        *,
        read_only: bool = False,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
        import_module: Callable[[str], Any] = importlib.import_module,
        open_camera: Callable[[OpenCvParameters, Callable[[], float]], Camera] = lambda settings, clock: OpenCvCamera(
            settings, clock
        ),
    ) -> None:
        self.settings = settings
        self._clock, self._sleep = clock, sleep
        self._offset = math.inf  # from the clock of the controller to ours
        self._asked_at = -math.inf
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()
        self._motion_fault: str | None = None
        self._is_closed = False
        self._control: Any = None
        self._gripper: RobotiqGripper | None = None
        self._camera: Camera | None = None
        receive, control = _interfaces(import_module)
        try:
            self._receive: Any = _connect(lambda: receive(settings.host, settings.frequency), settings.host)
            self._check_ready()
            self._gripper = RobotiqGripper(settings.host, settings.gripper, clock, sleep)
            if not read_only:
                self._control = _connect(lambda: control(settings.host, settings.frequency), settings.host)
                self._gripper.activate()
            self._camera = open_camera(settings.camera, clock)
        except Exception:
            self.close()
            raise

    def _check_ready(self) -> None:
        mode = int(self._receive.getRobotMode())
        if mode != _RUNNING:
            raise CellFault(
                f"the robot at {self.settings.host} is not running (robot mode {mode}, not {_RUNNING}): switch it on, "
                "and release its brakes at the teach pendant"
            )
        if (problem := self._safety_fault()) is not None:
            raise CellFault(f"the robot at {self.settings.host} reports {problem}")

    def _safety_fault(self) -> str | None:
        mode = int(self._receive.getSafetyMode())
        return SAFETY_MODES.get(mode, f"the unknown safety mode {mode}")

    # ---------------------------------------------------------------------------------------------------- clock, camera
    def now(self) -> float:
        return self._clock()

    def wait(self, duration_s: float) -> None:
        self._sleep(duration_s)

    def frame(self) -> CameraFrame:
        assert self._camera is not None
        return self._camera.frame()

    # ------------------------------------------------------------------------------------------------------------ arm
    def arm(self) -> ArmState:
        self._asked_at = self._clock()
        receive = self._receive
        try:
            if not receive.isConnected():
                raise CellFault(f"the connection to the robot at {self.settings.host} is lost")
            stamp = float(receive.getTimestamp())
            positions, velocities = np.array(receive.getActualQ()), np.array(receive.getActualQd())
            fault = self._safety_fault() or self._motion_fault
            mode = int(receive.getRobotMode())
        except RuntimeError as error:
            raise CellFault(f"the robot at {self.settings.host} does not answer: {error!s:.200}") from error
        if fault is None and mode != _RUNNING:
            fault = f"it is not running any more (robot mode {mode})"
        # A report is as old as its time stamp tells: the offset is that of the report that travelled fastest.
        now = self._clock()
        self._offset = min(self._offset, now - stamp)
        return ArmState(positions, velocities, stamp + self._offset, fault)

    def follow(self, trajectory: JointTrajectory) -> None:
        if self._control is None:
            raise CellFault("this is a dry run: the arm is not commanded")
        if trajectory.positions.shape[1:] != (NUM_JOINTS,):
            raise CellFault(f"a motion has {NUM_JOINTS} joints, not {list(trajectory.positions.shape[1:])}")
        if not self._end_motion():
            raise CellFault("the last motion does not end")
        self._motion_fault = None
        self._stopping.clear()
        self._asked_at = self._clock()
        self._thread = threading.Thread(target=self._stream, args=(trajectory,), name="servoj", daemon=True)
        self._thread.start()

    def _stream(self, trajectory: JointTrajectory) -> None:
        """Command the positions of the trajectory, one a period."""
        settings, control = self.settings, self._control
        period, started = 1.0 / settings.frequency, self._clock()
        fault = None
        try:
            while not self._stopping.is_set():
                since = self._clock() - started
                if since > trajectory.duration + _HOLD_S:
                    break
                if self._clock() - self._asked_at > settings.heartbeat_s:
                    fault = f"nobody has watched the motion for {settings.heartbeat_s:g} s; it was stopped"
                    break
                target = [float(np.interp(since, trajectory.times, joint)) for joint in trajectory.positions.T]
                begun = control.initPeriod()
                if not control.servoJ(target, 0.0, 0.0, period, settings.lookahead_s, settings.gain):
                    fault = "the controller refuses the motion: it is not in remote control, or its program has ended"
                    break
                control.waitPeriod(begun)
        except Exception as error:  # of the package
            fault = f"the motion was interrupted: {type(error).__name__}: {error!s:.200}"
        try:
            if not control.servoStop(settings.deceleration) and fault is None and not self._stopping.is_set():
                fault = "the controller did not take the end of the motion"
        except Exception as error:
            fault = fault or f"the end of the motion could not be commanded: {error!s:.200}"
        self._motion_fault = fault

    def _end_motion(self) -> bool:
        """Stop a motion in progress; whether it has ended."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(timeout=1.0)
            if self._thread.is_alive():
                return False
            self._thread = None
        return True

    # -------------------------------------------------------------------------------------------------------- gripper
    def gripper(self) -> GripperState:
        assert self._gripper is not None
        return self._gripper.state()

    def move_gripper(self, opening: float) -> None:
        if self._control is None or self._gripper is None:
            raise CellFault("this is a dry run: the gripper is not commanded")
        self._gripper.move(opening)

    # ----------------------------------------------------------------------------------------------------------- stop
    def stop(self) -> None:
        if self._control is None:
            return
        has_ended = self._end_motion()
        calls = [lambda: self._control.stopJ(self.settings.deceleration)]
        if not has_ended:
            calls.append(lambda: self._control.stopScript())
        if self._gripper is not None:
            calls.append(self._gripper.stop)
        for call in calls:
            try:
                call()
            except Exception:  # one device that fails does not keep the others from being stopped
                continue

    def close(self) -> None:
        if self._is_closed:
            return
        self._is_closed = True
        self.stop()
        devices = [self._camera, self._gripper]
        releases = [device.close for device in devices if device is not None]
        if self._control is not None:
            releases += [self._control.stopScript, self._control.disconnect]
        if getattr(self, "_receive", None) is not None:
            releases.append(self._receive.disconnect)
        for release in releases:
            try:
                release()
            except Exception:
                continue


def _interfaces(import_module: Callable[[str], Any]) -> tuple[Callable[..., Any], Callable[..., Any]]:
    try:
        receive, control = import_module("rtde_receive"), import_module("rtde_control")
    except ImportError as error:
        raise ConfigError(
            "cell=ur_rtde needs the package ur_rtde, for Python and this system: pip install ur_rtde"
        ) from error
    return receive.RTDEReceiveInterface, control.RTDEControlInterface


def _connect(open_interface: Callable[[], Any], host: str) -> Any:
    try:
        return open_interface()
    except RuntimeError as error:
        raise CellFault(
            f"the robot at {host} cannot be reached ({error!s:.200}); it has to be switched on, in remote control, "
            "with RTDE enabled"
        ) from error
