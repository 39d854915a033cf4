"""The gripper's protocol, against a server that speaks it."""

import pytest

from tests.embodiment.fake_ur import FakeGripper
from visualrhp.embodiment.robotiq_gripper import RobotiqGripper, RobotiqParameters
from visualrhp.errors import CellFault


@pytest.fixture
def server():
    server = FakeGripper()
    server.clients = []
    yield server
    for client in server.clients:
        client.close()
    server.close()


def connect(server, **settings):
    gripper = RobotiqGripper("127.0.0.1", RobotiqParameters(port=server.port, timeout_s=0.3, **settings))
    server.clients.append(gripper)
    return gripper


def test_it_is_activated_once(server):
    gripper = connect(server)
    gripper.activate()
    assert "SET ACT 1" in server.requests and server.variables["STA"] == 3
    number = len(server.requests)
    gripper.activate()
    assert server.requests[number:] == ["GET STA", "GET ACT"]


@pytest.mark.parametrize(("opening", "position"), [(0.085, 3), (0.0, 255), (0.0425, 116), (1.0, 3), (-1.0, 255)])
def test_openings_are_positions(server, opening, position):
    gripper = connect(server, speed=50, force=7)
    gripper.activate()
    gripper.move(opening)
    assert server.requests[-1] == f"SET POS {position} SPE 50 FOR 7 GTO 1"


@pytest.mark.parametrize(("position", "opening"), [(3, 0.085), (228, 0.0), (0, 0.085), (255, 0.0), (116, 0.0423)])
def test_positions_are_openings(server, position, opening):
    gripper = connect(server)
    gripper.activate()
    server.variables["POS"] = position
    state = gripper.state()
    assert state.opening == pytest.approx(opening, abs=2e-4) and state.fault is None and not state.is_moving


def test_it_moves_until_it_holds_something_or_is_stopped(server):
    gripper = connect(server)
    gripper.activate()
    server.holds_at = 100
    gripper.move(0.0)
    assert gripper.state().opening == pytest.approx(0.0484, abs=1e-3)
    server.variables["OBJ"] = 0
    assert gripper.state().is_moving
    gripper.stop()
    assert server.requests[-1] == "SET GTO 0"
    assert not gripper.state().is_moving


@pytest.mark.parametrize(("fault", "words"), [(14, "current"), (5, "activated"), (99, "fault 99"), (9, None)])
def test_faults_have_names(server, fault, words):
    gripper = connect(server)
    gripper.activate()
    server.variables["FLT"] = fault
    state = gripper.state()
    assert (state.fault is None) if words is None else words in state.fault


def test_a_gripper_that_is_not_active_is_a_fault(server):
    assert "not active" in str(connect(server).state().fault)


def test_answers_without_a_line_break_are_read(server):
    server.line_end = b""
    gripper = connect(server)
    gripper.stop()
    assert server.requests == ["SET GTO 0"]


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (lambda request, answer: "?", "answered '\\?' to GET POS"),
        (lambda request, answer: "OBJ 3", "answered 'OBJ 3'"),
        (lambda request, answer: "POS x", "answered 'POS x'"),
        (lambda request, answer: None, "closed"),
        (lambda request, answer: "", "answered ''"),
    ],
)
def test_answers_that_are_none_are_faults(server, answer, words):
    gripper = connect(server)
    server.answer = answer
    with pytest.raises(CellFault, match=words):
        gripper.state()
    with pytest.raises(CellFault):
        gripper.stop()


def test_silence_is_a_fault(server):
    gripper = connect(server)
    server.line_end = b""
    server.answer = lambda request, answer: ""
    with pytest.raises(CellFault, match=r"does not answer GET POS .*timed out"):
        gripper.state()


def test_a_gripper_that_does_not_get_active_is_a_fault(server):
    server.answer = lambda request, answer: "STA 1" if request == "GET STA" else answer
    with pytest.raises(CellFault, match=r"not active 0\.2 s"):
        connect(server, activation_s=0.2).activate()


def test_no_gripper_is_a_fault():
    free = FakeGripper()
    free.close()
    with pytest.raises(CellFault, match="cannot be reached"):
        connect(free)
