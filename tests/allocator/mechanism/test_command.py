"""`antagonist allocate` and `map` of several joints: degrees and bar outside, one sentence for what is wrong."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from allocator import InvalidInput, Stiffness, allocate, named_muscle, save_machine
from allocator.cli import app
from allocator.feasibility import feasible_targets
from allocator.mechanism import Endpoint, Pulleys, machines
from allocator.mechanism.bodies import leg37_bodies
from allocator.units import BAR, DEG
from mpc.arm.mjcf import to_mjcf
from mpc.model.arm.model import Arm
from mpc.model.arm.storage import arm_text

ARM = ("allocate", "--machine", "arm26")


def run(*arguments):
    return CliRunner().invoke(app, [*map(str, arguments)])


def test_the_answer_is_that_of_python():
    done = run(*ARM, "--posture", "23,-17", "--torque", "9.36,4.09", "--stiffness", "10.17,3.98,8.76", "--json")
    assert done.exit_code == 0
    printed = json.loads(done.stdout)
    K = [[10.17, 3.98], [3.98, 8.76]]
    a = allocate(np.array([23, -17]) * DEG, K, [9.36, 4.09], joint=machines.arm26())
    assert printed["P_bar"] == pytest.approx(a.P / BAR, rel=1e-12)
    assert printed["status"] == "EXACT"
    assert printed["met"]
    assert printed["holds_itself"]
    assert printed["separating_reach"] is None


def test_units_and_names_in_brackets_are_printed(tmp_path):
    """Tables would take [bar] and [left] for markup."""
    path = tmp_path / "arm.toml"
    save_machine(replace(machines.arm26(), joint_names=("hip [left]", "knee [left]")), path)
    printed = run("allocate", "--machine", path, "--posture", "23,-17", "--stiffness", "10,4,9").output
    assert "pressure [bar]" in printed
    assert "hip [left]" in printed


def test_what_cannot_be_met_has_its_exit_code_and_its_muscles():
    done = run(*ARM, "--posture", "23,-17", "--torque", "9.36,4.09", "--stiffness", "20")
    assert done.exit_code == 3
    assert "STIFFNESS_LIMITED" in done.stdout
    assert "in the way: shoulder flexor upper" in done.stdout
    done = run(*ARM, "--posture", "23,-17", "--stiffness", "20,19", "--priority", "stiffness", "--json")
    printed = json.loads(done.stdout)
    assert printed["separating_reach"] < printed["separating_asked"]


def test_a_file_stands_for_a_machine(tmp_path):
    path = tmp_path / "arm.toml"
    save_machine(machines.arm26(), path)
    asked = ("--posture", "5,-5", "--torque", "1", "--stiffness", "20,15,9", "--json")
    assert run("allocate", "--machine", path, *asked).stdout == run(*ARM, *asked).stdout


def weight_of(bodies, q):
    """Return the slope [N·m] of the links' height over the angles, by central differences of their places."""

    def potential(q):
        ends, masses = bodies.points(q), np.array(bodies.mass)
        along = np.array(bodies.centre) / np.array(bodies.length)
        centres = ends[:-1] + along[:, None] * np.diff(ends, axis=0)
        return -masses @ centres @ np.array(bodies.gravity)

    return [(potential(q + h) - potential(q - h)) / 2e-6 for h in 1e-6 * np.eye(bodies.n)]


@pytest.fixture(params=["leg37", "leg.toml", "leg.xml"])
def standing_leg(request, tmp_path):
    """The leg with gravity, by its name, in a file, and as a MuJoCo model."""
    arm = Arm.machine("leg37")
    if request.param == "leg37":
        return (request.param,)
    path = tmp_path / request.param
    if path.suffix == ".toml":
        path.write_text(arm_text(arm), encoding="utf-8")
        return (path,)
    path.write_text(to_mjcf(arm.mechanism, arm.bodies), encoding="utf-8")
    return path, "--muscle", "sarosi-dmsp-20-400n"


def test_bodies_of_another_machine_have_no_weight_here(tmp_path):
    path, leg = tmp_path / "arm.toml", arm_text(Arm.machine("leg37"))
    save_machine(machines.arm26(), path)
    path.write_text(
        path.read_text(encoding="utf-8") + leg[leg.index("[bodies]") : leg.index("[plant]")], encoding="utf-8"
    )
    failed = run("allocate", "--machine", path, "--posture", "23,-17", "--torque", "1", "--stiffness", "10")
    assert "[bodies]: Arm: bodies of 3 links for a mechanism with n = 2 joints" in str(failed.exception)


def test_the_torque_is_beyond_gravity(standing_leg, tmp_path):
    q, asked = np.array([20, -30, 10]) * DEG, ("--posture", "20,-30,10")
    held = np.array(weight_of(leg37_bodies(), q))
    answer = run("allocate", "--machine", *standing_leg, *asked, "--torque", "1", "--stiffness", "26,15,9", "--json")
    printed = json.loads(answer.stdout)
    assert printed["gravity_Nm"] == pytest.approx(held, abs=1e-6)
    muscles = machines.leg37().torque(q, np.array(printed["P_bar"]) * BAR)
    assert muscles == pytest.approx(held + 1, abs=1e-5)
    out = tmp_path / "map.png"
    drawn = run("map", "--machine", *standing_leg, *asked, "--torque", "1", "--json", "--out", out)
    assert list(json.loads(drawn.stdout)["held"].values()) == pytest.approx(held + 1, abs=1e-5)
    said = f"{', '.join(f'{T:.3g}' for T in held)} N·m of the torque balance gravity"
    assert said in run("map", "--machine", *standing_leg, *asked, "--out", tmp_path / "said.png").stdout


def test_options_change_all_muscles_and_say_which_stiffness_is_meant():
    asked = ("--posture", "10,20", "--stiffness", "15,12", "--valves", "shut", "--json")
    changed = ("--supply", 6, "--muscle", "sarosi-dmsp-20-200n", "--initial-contraction", "0.12", "--rest-length", 300)
    printed = json.loads(run(*ARM, *asked, *changed).stdout)
    arm, weak = machines.arm26(), named_muscle("sarosi-dmsp-20-200n")
    routes = Pulleys(0.3, arm.routes.arms, 0.12)
    other = replace(arm, routes=routes, muscles=(weak,) * 6, pressure_limits=(0.0, 6 * BAR))
    a = allocate(np.array([10, 20]) * DEG, [15.0, 12.0], joint=other, stiffness=Stiffness("shut"))
    assert printed["P_bar"] == pytest.approx(a.P / BAR, rel=1e-9)
    assert "shut stiffness given" in " ".join(run(*ARM, *asked[:-1], *changed).stdout.split())


def test_each_muscle_may_be_another_one():
    names = ["sarosi-dmsp-20-200n", "sarosi-dmsp-20-400n"] * 3
    given = [part for name in names for part in ("--muscle", name)]
    printed = json.loads(run(*ARM, "--posture", "10,20", "--stiffness", "8,8", "--json", *given).stdout)
    other = replace(machines.arm26(), muscles=tuple(map(named_muscle, names)))
    a = allocate(np.array([10, 20]) * DEG, [8.0, 8.0], joint=other)
    assert printed["P_bar"] == pytest.approx(a.P / BAR, rel=1e-9)


def test_help_has_its_options_in_panels():
    said = run("allocate", "--help-all").stdout
    panels = ["Options:", "Machine:", "Kind of stiffness:", "Several joints:"]
    places = [said.index(panel) for panel in panels]
    assert places == sorted(places)
    assert said.index("Machine:") < said.index("--supply") < said.index("Kind of stiffness:")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--stiffness", "9"), "give --posture, the angles of"),
        (("--stiffness", "9", "--posture", "1,2,3"), "--posture 1,2,3: expected 2 .the angles of shoulder, elbow"),
        (("--stiffness", "9", "--posture", "1,x"), "--posture 1,x: expected 2"),
        (("--stiffness", "9", "--posture", "1,400"), "over a turn"),
        (("--stiffness", "9,8,7,6", "--posture", "1,2"), "expected 1 .* or 2 .* or 3 .the upper triangle"),
        (("--stiffness", "inf", "--posture", "1,2"), "expected a finite number"),
        (("--stiffness", "9,50,9", "--posture", "1,2"), "has to be positive definite"),
        (("--stiffness", "9", "--posture", "1,2", "--theta", "5"), "--theta is of a joint"),
        (("--stiffness", "9", "--posture", "1,2", "--radius", "20"), "--radius is for one joint with two muscles"),
        (("--stiffness", "9", "--posture", "1,2", "--muscle", "tondu-mckibben", "--muscle", "tondu-mckibben"), "once"),
        (("--stiffness", "9", "--posture", "1,2", "--at-least", "--valves", "shut"), "of the isobaric stiffness"),
        (("--stiffness", "9", "--posture", "1,2", "--valves", "agonist"), "choose one of open, shut$"),
        (("--stiffness", "9", "--posture", "1,2", "--torque", "1,2,3"), "--torque 1,2,3: expected 1"),
    ],
)
def test_wrong_options(arguments, sentence):
    done = run(*ARM, *arguments)
    assert isinstance(done.exception, InvalidInput)
    with pytest.raises(InvalidInput, match=sentence):
        raise done.exception


@pytest.mark.parametrize(
    "arguments", ["--stiffness 7", "--theta 5 --stiffness 7 --posture 1", "--theta 5 --stiffness 7,8"]
)
def test_a_joint_needs_an_angle_and_one_stiffness(arguments):
    done = run("allocate", *arguments.split())
    assert isinstance(done.exception, InvalidInput)


LINKS = ("--links", "300,250", "--links-at-zero", "45,90")


def test_the_stiffness_of_a_hand_is_that_of_python():
    asked = ("--posture", "5,10", "--stiffness", "80,5,150", "--push", "2,-1", "--torque", "0.5,0", "--json")
    done = run(*ARM, *LINKS, *asked)
    assert done.exit_code == 0, done.output
    printed = json.loads(done.stdout)
    hand = Endpoint.planar([0.3, 0.25], np.array([45, 90]) * DEG)
    q = np.array([5, 10]) * DEG
    asked = {"stiffness": Stiffness(endpoint=hand, force=[2.0, -1.0])}
    a = allocate(q, [[80.0, 5.0], [5.0, 150.0]], [0.5, 0.0], joint=machines.arm26(), **asked)
    assert printed["P_bar"] == pytest.approx(a.P / BAR, rel=1e-9)
    assert np.ravel(printed["endpoint_stiffness_N_per_m"]) == pytest.approx([80.0, 5.0, 5.0, 150.0])
    assert printed["position_m"] == pytest.approx(hand.position(q))


def test_at_least_a_stiffness():
    asked = ("--posture", "0,0", "--stiffness", "60", "--at-least")
    done = run(*ARM, *LINKS, *asked)
    assert done.exit_code == 0, done.output
    assert "the stiffness is enough, with the least pressures" in done.stdout
    assert "the hand at [0.03536, 0.3889] m" in done.stdout
    done = run(*ARM, *LINKS, "--posture", "0,0", "--stiffness", "200", "--at-least", "--json")
    assert done.exit_code == 3
    printed = json.loads(done.stdout)
    assert printed["status"] == "STIFFNESS_LIMITED"
    assert printed["separating_reach"] < printed["separating_asked"]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--stiffness", "9", "--posture", "1,20", "--links", "300"), "--links 300: expected 2 .one a link"),
        (("--stiffness", "9", "--posture", "1,20", "--links", "0.3,0.25"), "--links 0.25: expected 1 to 10000 mm"),
        (("--stiffness", "9", "--posture", "1,0", "--links", "300,250"), "Jacobian is singular"),
        (("--stiffness", "9", "--posture", "1,20", "--push", "1,2"), "--push goes with --links"),
        (("--stiffness", "9", "--posture", "1,20", *LINKS, "--push", "1"), "--push 1: expected 2 .its x and y"),
        (("--stiffness", "9,8,7,6", "--posture", "1,20", *LINKS), r"expected 1 .* 2 .* 3 .* \[N/m\]"),
        (("--stiffness", "9", "--posture", "1,20", "--at-least", "--priority", "stiffness"), "--at-least goes without"),
        (("--stiffness", "9", "--posture", "1,20", "--priority", "weighted"), "choose torque or stiffness"),
    ],
)
def test_wrong_options_of_a_hand(arguments, sentence):
    done = run(*ARM, *arguments)
    assert isinstance(done.exception, InvalidInput)
    with pytest.raises(InvalidInput, match=sentence):
        raise done.exception


def test_a_map_is_the_polygon_of_python(tmp_path):
    path = tmp_path / "map.png"
    asked = ("--posture", "23,-17", "--targets", "K11,K12", "--torque", "2,1", "--out", path, "--json")
    done = run("map", "--machine", "arm26", *asked)
    assert done.exit_code == 0, done.output
    printed = json.loads(done.stdout)
    feasible = feasible_targets(machines.arm26(), np.array([23, -17]) * DEG)
    polygon = feasible.polygon("K11", "K12", {"T1": 2.0, "T2": 1.0})
    assert printed["area"] == pytest.approx(polygon.area)
    assert [edge["limits"] for edge in printed["edges"]] == [list(edge.active) for edge in polygon.edges]
    assert path.stat().st_size > 10_000


def test_torques_are_free_or_those_that_hold_the_hand(tmp_path):
    leg = ("map", "--machine", "leg37", "--posture", "5,-5,10", "--out", tmp_path / "free.svg")
    free = run(*leg, "--torque", "free", "--targets", "T1,K22")
    assert "T1 and K22: " in free.stdout
    pushing = ("--posture", "5,10", "--push", "10,0", "--json", "--out", tmp_path / "push.png")
    held = json.loads(run("map", "--machine", "arm26", *LINKS, *pushing).stdout)["held"]
    hand = Endpoint.planar([0.3, 0.25], np.array([45, 90]) * DEG)
    assert list(held.values()) == pytest.approx(hand.torque(np.array([5, 10]) * DEG, [10.0, 0.0]))


@pytest.mark.slow
def test_a_hand_without_a_posture_has_its_workspace_drawn(tmp_path):
    done = run("map", "--machine", "arm26", *LINKS, "--out", tmp_path / "w.png")
    assert done.exit_code == 0, done.output
    assert "30 postures, torques exist at 30; the ellipse turns by" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--machine", "arm26"), "or --links or --hand to draw a workspace"),
        (("--machine", "arm26", "--posture", "1,2", "--targets", "K11"), "--targets K11: expected two"),
        (("--machine", "arm26", "--posture", "1,2", "--targets", "Kx11,K12"), "no target 'Kx11'.*needs an endpoint"),
        (("--machine", "arm26", "--posture", "1,2", "--stiffness", "1:9"), "--stiffness are ranges of one joint"),
        (("--machine", "arm26", "--posture", "1,2", "--theta", "5"), "--theta and --stiffness are ranges of one joint"),
        (("--machine", "arm26", "--posture", "1,2", "--out", "map.csv"), "the ending has to be one of .png"),
        (("--machine", "arm48", "--links", "1,2,3,4"), "the workspace is drawn of n = 2 joints, not 4"),
        (("--machine", "arm26", *LINKS, "--torque", "free"), "--torque free goes with --posture"),
        (("--targets", "K11,K22"), "--targets is for several joints"),
        (("--posture", "1,2"), "--posture goes with a --machine of several joints"),
    ],
)
def test_wrong_options_of_a_map(arguments, sentence, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = run("map", *arguments)
    assert isinstance(done.exception, InvalidInput)
    with pytest.raises(InvalidInput, match=sentence):
        raise done.exception
    assert not list(tmp_path.iterdir())
