"""Ready-made machines do what they are for; files give back what was written."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import (
    InvalidFile,
    InvalidInput,
    Lever,
    MissingBackend,
    allocate,
    load_machine,
    report_joint,
    save_machine,
)
from allocator.machine_file import load_joint, named_machine
from allocator.mechanism import (
    Link,
    Mechanism,
    Sites,
    Tables,
    from_function,
    machines,
)
from allocator.muscles import Cabled, Muscle
from allocator.muscles.catalogue import MARTENS_DMSP_20_300, SAROSI_DMSP_20_200N, SAROSI_DMSP_20_400N
from allocator.units import BAR

_GRID = np.linspace(-0.5, 0.5, 5)
SHAPES = {"arm26": (2, 6, 1), "arm48": (4, 8, 0), "leg37": (3, 7, 2)}  # n, m, couplings of joints


@pytest.mark.parametrize("name", SHAPES)
def test_machines_hold_themselves_and_couple_what_they_should(name):
    machine = named_machine(name)
    n, m, coupled = SHAPES[name]
    assert (machine.n, machine.m) == (n, m)
    q = np.array(machine.angle_limits).mean(axis=1)
    lo, hi = machine.pressure_box(q)
    P = (lo + hi) / 2
    K = machine.stiffness(q, P)
    assert np.linalg.eigvalsh(K)[0] > 0
    assert (np.abs(np.triu(K, 1)) > 0.1).sum() == coupled
    again = allocate(q, K, machine.torque(q, P), joint=machine)
    assert again.success
    assert (machine.contractions([[low for low, _ in machine.angle_limits]]) > 0).all()


def test_unknown_machines_list_the_known_ones():
    with pytest.raises(MissingBackend, match="arm26, arm48, leg37"):
        named_machine("arm27")
    with pytest.raises(InvalidInput, match=r"arm.xml is a MuJoCo model: Mechanism.from_mjcf"):
        named_machine("arm.xml")


MECHANISMS = {
    **{name: make() for name, make in machines.MACHINES.items()},
    "sites": Mechanism(
        Sites(
            [0.4, 0.3],
            [Link(), Link(0, (0.3, 0.0), kind="slide", axis=(1.0, 0.0, 0.0), zero=0.1)],
            [[(-1, (0.1, 0.1)), (0, (0.2, 0.1))], [(-1, (0.1, -0.1)), (0, (0.2, -0.1)), (1, (0.2, 0.1))]],
            cable=[0.01, 0.0],
        ),
        (SAROSI_DMSP_20_200N, MARTENS_DMSP_20_300),
        pressure_limits=(0.2 * BAR, 6 * BAR),
        muscle_names=("short", 'the "long" one\x7f'),
    ),
    "tables": Mechanism(Tables(0.4, [_GRID], 0.35 + np.outer(_GRID, [-0.02, 0.02])), SAROSI_DMSP_20_400N),
}


@pytest.mark.parametrize("mechanism", MECHANISMS.values(), ids=MECHANISMS.keys())
def test_a_file_gives_back_what_was_written(tmp_path, mechanism):
    path = tmp_path / "machine.toml"
    save_machine(mechanism, path, source={"paper": "none", "year": 2026})
    assert load_machine(path) == mechanism
    assert named_machine(str(path)) == mechanism
    assert hash(load_machine(path)) == hash(mechanism)


def test_the_covariance_of_a_muscle_travels_with_its_joint_or_arm(tmp_path):
    law = MARTENS_DMSP_20_300
    sizes = np.array(list(law.parameters.values()))
    fitted = replace(law, covariance=np.diag((0.01 * sizes) ** 2))
    tied = Cabled(fitted, cable_stiffness=4e4, rest_length=0.4)
    mixed = replace(report_joint(fitted), antagonist=tied)
    for machine in (report_joint(fitted), mixed, replace(machines.arm26(), muscles=(fitted, law) * 3)):
        save_machine(machine, tmp_path / "fitted.toml")
        assert load_machine(tmp_path / "fitted.toml") == machine
    tied.save(tmp_path / "tied.toml")
    assert Muscle.load(tmp_path / "tied.toml") == tied


def test_functions_are_not_written(tmp_path):
    made = Mechanism(from_function(0.4, 1, lambda q: 0.3 - 0.02 * q), SAROSI_DMSP_20_400N)
    led = replace(report_joint(), geometry=Lever(rest_length=0.4, anchor=0.3, lever=0.03, offset=0.0435))
    for mechanism in (made, Mechanism.from_joint(led)):
        with pytest.raises(InvalidInput, match="cannot be written to a file; sample the lengths into Tables"):
            save_machine(mechanism, tmp_path / "x.toml")


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("[routes]", "[roots]", r"the table \[routes\] is missing"),
        (
            'kind = "Pulleys"',
            'kind = "Ropes"',
            "unknown kind 'Ropes'; known: Pulley, Lever, Table, Pulleys, Sites, Tables",
        ),
        (
            "initial_contraction =",
            "contraction =",
            r"\[routes\]: a Pulleys has no contraction; it has rest_length, arms, initial_contraction",
        ),
        ('like = "shoulder flexor"', 'like = "biceps"', "has to be the name of a muscle above: shoulder flexor"),
        ('like = "shoulder flexor"', "like = []", r"like = \[\] has to be the name of a muscle above"),
        ('kind = "Pulleys"', "kind = [1]", r"unknown kind \[1\]; known: Pulley"),
        ('joints = ["shoulder", "elbow"]', "joints = 2", "joints = 2 has to be a list of names"),
        ('name = "elbow flexor"', 'name = "shoulder flexor"', "has to be a name, and no other muscle's"),
        ('name = "biarticular extensor"\n', "", r"name is missing: each \[\[muscle\]\] of a mechanism has its own"),
        ('[[muscle]]\nname = "biarticular extensor"\nlike = "shoulder flexor"', "", "5 given; .* m = 6"),
        (
            "[machine]",
            "[hysteresis]\n[machine]",
            "the file of a machine with the routes Pulleys has no hysteresis; it has machine",
        ),
        ("min_contraction", "max_contraction", "has no max_contraction; it has"),
        ("[0.0, 500000.0]", "[0.0, 5.0]", "if bar was meant"),
        ("c1 =", "c9 =", "c1"),
        ("[[muscle]]", "[[muscle", "is not TOML"),
    ],
)
def test_files_that_are_none(tmp_path, old, new, sentence):
    path = tmp_path / "machine.toml"
    save_machine(machines.arm26(), path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(InvalidFile, match=sentence) as raised:
        load_machine(path)
    assert str(path) in str(raised.value)


def test_a_joint_s_file_is_a_machine_s(tmp_path):
    path = tmp_path / "joint.toml"
    save_machine(report_joint(), path)
    assert load_machine(path) == load_joint(path) == named_machine(str(path)) == report_joint()
    assert path.read_text().count("r0 =") == 1  # the antagonist is like the agonist
    save_machine(machines.arm26(), path)
    with pytest.raises(InvalidFile, match="holds a machine with n = 2 joints and m = 6 muscles; expected one joint"):
        load_joint(path)


def test_a_joint_written_by_hand_has_its_forces_in_newtons(tmp_path):
    path = tmp_path / "joint.toml"
    save_machine(report_joint(), path)
    text = path.read_text()
    assert "scale_known = true\n" in text
    path.write_text(text.replace("scale_known = true\n", ""))
    assert load_joint(path) == report_joint()


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("[machine]", "[joint]", r"is not a machine: the table \[machine\] is missing"),
        ('"agonist"', '"biceps"', r"a joint has the \[\[muscle\]\]s agonist and antagonist, not biceps"),
        (
            "friction =",
            'joints = ["elbow"]\nfriction =',
            r"\[machine\]: the file of a joint with the routes Pulley has no joints; it has",
        ),
        (
            "[routes]",
            "[bodies]\n[routes]",
            "the file of a joint with the routes Pulley has no bodies; it has machine, routes, muscle",
        ),
        ("    [-2.181661564992912, 2.181661564992912],", "-2.0, 2.0", "angle_limits has one row of a joint"),
        ("scale_known = true", 'scale_known = "yes"', r"\[machine\]: scale_known = 'yes' has to be true or false"),
        ("[routes]", "[measured]\ncontraction = [0.1]\n[routes]", r"below its \[\[muscle\]\], as \[muscle.measured\]"),
        ("scale_known = true", "scale_known = false", "holds a joint whose force scale is unknown"),
    ],
)
def test_files_that_are_no_joint(tmp_path, old, new, sentence):
    path = tmp_path / "joint.toml"
    save_machine(report_joint(), path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(InvalidFile, match=sentence):
        load_machine(path)
