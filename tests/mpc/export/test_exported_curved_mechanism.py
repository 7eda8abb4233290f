"""The exported allocation of muscles that are not affine in the pressure says and proves what Python's does."""

from dataclasses import dataclass
from functools import cache
from typing import ClassVar

import numpy as np
import pytest
from typer.testing import CliRunner

from allocator.calculus import cos, is_symbol, sin
from allocator.errors import InvalidInput
from allocator.mechanism import Mechanism, MechanismStatus, Pulleys, allocate_mechanism
from allocator.muscles import Muscle
from allocator.muscles.basis import Basis
from allocator.units import BAR
from benchmarks.mechanisms.exported import ANDRIKOPOULOS, FAILED, MAIN, MECHANISMS, answered, questions
from mpc.cli import app
from mpc.export.mechanism import curved
from mpc.export.mechanism.entry import export_mechanism

from ...rigs import toolchain as tools
from ...rigs.needs import needs

GAP = 1e-3

needs_gcc = needs("gcc")


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """Return what exports a mechanism of the list, once, and the directory."""

    @cache
    def made(name, precision="double"):
        return export_mechanism(tmp_path_factory.mktemp("c") / "c", MECHANISMS[name], precision=precision)

    return made


@needs_gcc
@pytest.mark.tools
@pytest.mark.slow
@pytest.mark.parametrize("name", MECHANISMS)
def test_c_gives_pythons_pressures_statuses_and_costs_and_proves_them(name, exported):
    asked = questions(MECHANISMS[name], 3)
    made = asked.of_c(answered(tools.compiled(exported(name), MAIN, "replay"), asked.rows))
    given, expected = asked.costs(made["y"]), asked.costs(asked.y)
    assert np.abs(made["P"] - asked.P).max() < 1e-8 * 5 * BAR
    assert given == pytest.approx(expected, rel=1e-9, abs=1e-9)
    same = made["status"] == asked.status
    assert (same | (asked.status == FAILED)).all()  # what Python cannot prove C may
    assert (made["status"] != FAILED).all()
    assert (made["gap"] <= GAP).all()
    assert (made["bounds"] <= expected * (1 + 1e-9) + 1e-9).all()
    assert {MechanismStatus.EXACT, MechanismStatus.STIFFNESS_LIMITED} & {*asked.status}
    assert (asked.status != MechanismStatus.EXACT).any()


@needs_gcc
@pytest.mark.tools
@pytest.mark.slow
def test_single_precision_differs_by_its_digits_and_says_what_it_cannot_prove(exported):
    asked = questions(MECHANISMS["bends, five laws"], 5, seed=1, dtype=np.float32)
    out = exported("bends, five laws", "single")
    made = asked.of_c(answered(tools.compiled(out, MAIN, "replay", "-O2", "-Wdouble-promotion"), asked.rows))
    failed = made["status"] == FAILED
    given, expected = asked.costs(made["y"]), asked.costs(asked.y)
    assert given[~failed] == pytest.approx(expected[~failed], rel=1e-4, abs=1e-4)
    assert (given <= expected * 1.0001 + 1e-4).all()
    assert np.median(np.abs(made["P"] - asked.P).max(axis=1)) < 1e-5 * 5 * BAR
    assert np.mean(made["status"] == asked.status) > 0.9
    assert failed.mean() < 0.1
    assert (made["gap"][~failed & (made["status"] >= 0)] <= GAP * 1.01).all()
    assert (made["bounds"] <= asked.costs(asked.y) * 1.001 + 1e-4).all()


@needs_gcc
@pytest.mark.tools
@pytest.mark.slow
def test_no_pressures_that_give_the_torque_are_nearer_in_stiffness_than_the_proof_says(exported):
    """One joint against all its pressures: for every P1 the P2 that gives the torque, by the law's own inverse."""
    mechanism, rng = MECHANISMS["one joint"], np.random.default_rng(3)
    rows = []
    for q, P1, P2, factor in rng.uniform((-0.3, 1.5e5, 1.5e5, 0.2), (0.3, 5e5, 5e5, 2.5), (40, 4)).tolist():
        T, K = mechanism.torque([q], [P1, P2])[0], factor * mechanism.stiffness([q], [P1, P2])[0, 0]
        rows.append([q, T, K, 0.0, np.inf, 0.0, 0.0, np.inf, 0, 0, 0])
    made = answered(tools.compiled(exported("one joint"), MAIN, "replay"), rows)
    met = 0
    for row, line in zip(rows, made, strict=True):
        (q, T, K), (lo, hi) = row[:3], mechanism.pressure_box(row[:1])
        muscles, P1 = mechanism.at(np.array([q])), np.linspace(lo[0], hi[0], 20_001)
        F2 = muscles[0].force(P1) - T / 0.02
        P2 = muscles[1].muscle.pressure(F2, muscles[1].contraction)
        there = (P2 >= lo[1]) & (P2 <= hi[1])
        pairs = np.stack([P1[there], P2[there]], axis=-1)
        cost = (mechanism.stiffness([q], pairs)[:, 0, 0] - K) ** 2
        assert line[2] == pytest.approx(T, abs=1e-6)
        own = (line[3] - K) ** 2
        met += int(line[5]) == MechanismStatus.EXACT
        assert own <= cost.min() + 1e-9
        assert line[9] <= cost.min() + 1e-9  # the bound
        assert own - line[9] <= GAP * (1 + own)
    assert 5 < met < 35


@needs_gcc
@pytest.mark.tools
def test_what_is_not_proved_is_said_and_stays_within_the_limits(exported):
    out = exported("one joint")
    main = (out / "main.c").read_text().replace("#include <stdio.h>", "#include <stdio.h>\n#include <stdlib.h>")
    main = main.replace("(void)", "(int argc, char **argv)", 1).replace(
        "ant_allocation a;", "ant_allocation a; target.nodes = atoi(argv[argc - 1]);"
    )
    (out / "by_nodes.c").write_text(main)
    program = tools.compiled(out, out / "by_nodes.c", "by_nodes")
    shown = {nodes: tools.run(program, str(nodes)) for nodes in (0, 1, 500)}
    statuses = {nodes: [int(line.split()[-1]) for line in text.splitlines()] for nodes, text in shown.items()}
    assert FAILED in statuses[0]
    assert FAILED not in statuses[500]
    proved = [s == t for s, t in zip(statuses[0], statuses[500], strict=True)]
    assert all(good or s == FAILED for good, s in zip(proved, statuses[0], strict=True))
    for text in shown.values():
        P = np.array([line.split(": P ")[1].split(" Pa")[0].split() for line in text.splitlines()], float)
        assert ((P >= 0) & (P <= 5 * BAR)).all()


@needs_gcc
@pytest.mark.tools
def test_a_law_that_falls_where_it_is_slack_is_followed_where_it_rises(tmp_path):
    """Its force falls from 0 Pa on, and is 0 again where the muscle is taut: at 1 kPa at some postures."""
    mechanism = Mechanism(Pulleys(0.4, [(0.02,), (-0.02,)], 0.13), ANDRIKOPOULOS)
    program = tools.compiled(export_mechanism(tmp_path / "c", mechanism), MAIN, "replay", *tools.SANITISED)
    q = np.linspace(-0.6, 0.6, 25)
    expected = allocate_mechanism(mechanism, q[:, None], np.array([[[3.0]]]), 0.4)
    least = mechanism.pressure_box(q[:, None])[0]
    assert least[least > 0].min() < 5e3 < least.max()
    made = answered(program, [[angle, 0.4, 3.0, 0.0, np.inf, 0.0, 0.0, np.inf, 0, 0, 0] for angle in q])
    assert made[:, :2] == pytest.approx(expected.P, abs=1e-2)
    np.testing.assert_array_equal(made[:, 5], expected.status)
    with pytest.raises(InvalidInput, match="does not rise with the pressure"):
        allocate_mechanism(mechanism, [0.0], [[8.0]], [1.0], min_force=None)
    [slack] = answered(program, [[0.0, 1.0, 8.0, -np.inf, np.inf, 2e5, 2e5, np.inf, 0, 0, 0]])
    assert slack[5] == FAILED  # where Python refuses
    assert ((slack[:2] >= 0) & (slack[:2] <= 5 * BAR)).all()


@needs_gcc
@pytest.mark.tools
def test_senseless_questions_are_answered_within_the_supply(exported):
    good = questions(MECHANISMS["Tondu2021"], 3).rows[0]
    wrong = []
    for place in (0, 2, 4, 7, 8, 9, 15, 18):  # q, T, K11, both forces, the pressures now, step, priority
        for value in (np.nan, np.inf, -np.inf, 1e300, -1.0):
            row = good.copy()
            row[place] = value
            wrong.append(row)
    flags = *tools.SANITISED, "-fno-sanitize=float-cast-overflow"
    program = tools.compiled(exported("Tondu2021"), MAIN, "sane", *flags)
    made = answered(program, wrong)
    assert ((made[:, :6] >= 0) & (made[:, :6] <= 5 * BAR)).all()
    assert (made[[0, 1, 2, 5, 6, 7, 25, 26, 27], 12] == -1).all()


@needs_gcc
@pytest.mark.tools
@pytest.mark.parametrize("precision", ["double", "single"])
def test_the_readmes_line_builds_the_demonstration_which_prints_what_the_readme_says(precision, exported):
    out = exported("Tondu2021" if precision == "double" else "bends, five laws", precision)
    flags = ("-O2", "-Wdouble-promotion") if precision == "single" else ()
    program = tools.compiled(out, out / "main.c", "demonstration", *flags)
    readme = (out / "README.md").read_text()
    shown, said = tools.run(program).splitlines(), readme.split("```text\n")[1].split("```")[0].splitlines()
    if precision == "double":
        assert shown == said
    assert [line.split()[-1] for line in shown] == [line.split()[-1] for line in said]
    assert "branch and bound" in readme


@needs_gcc
@pytest.mark.tools
def test_a_followed_target_begins_at_the_last_answer(exported):
    asked = questions(MECHANISMS["Tondu2021"], 3)
    rows = np.repeat(asked.rows, 2, axis=0)
    rows[1::2, -2] = 1  # every target twice, and the second time it follows
    made = asked.of_c(answered(tools.compiled(exported("Tondu2021"), MAIN, "replay"), rows))
    assert made["P"][1::2] == pytest.approx(made["P"][::2], abs=1e-3)
    assert (made["status"][1::2] == made["status"][::2]).all()


@pytest.mark.tools
def test_the_command_exports_a_mechanism_with_another_muscle(tmp_path):
    def invoke(*more):
        return CliRunner().invoke(app, ["export", "--mechanism", "leg37", "--out", str(tmp_path / "c"), *more])

    refused = invoke("--supply", "6", "--muscle", "tondu-dmsp-20-400n")
    assert "leave --supply away" in str(refused.exception)
    made = invoke("--muscle", "tondu-dmsp-20-400n", "--precision", "single")
    assert made.exit_code == 0, made.output
    config = (tmp_path / "c" / "antagonist_config.h").read_text()
    assert "#define ANT_CURVED" in config
    assert "#define ANT_SINGLE" in config


@dataclass(frozen=True)
class Waving(Muscle):
    """A law whose stiffness over its force turns every 9 kPa, or jumps at 2.5 bar."""

    jump: float = 0.0
    citation: ClassVar[str] = "none"

    @property
    def basis(self):
        return Basis("smooth", kinks=(2.5e5,) if self.jump else ())

    def law(self, P, eps):
        import casadi as ca

        high = ca.if_else(P > 2.5e5, 1.0, 0.0) if is_symbol(P) else np.where(np.real(P) > 2.5e5, 1.0, 0.0)
        wave = 0.0 if self.jump else 3.0 * eps * sin(P / 9e3)
        return 1e-3 * P * (1 - 2 * eps) + wave - 100.0 * eps + self.jump * high * eps

    def gain(self, P, eps):
        return 1e-3 * (1 - 2 * eps) + (0.0 * P if self.jump else 3.0 / 9e3 * eps * cos(P / 9e3))


@pytest.mark.parametrize(
    ("muscle", "said"), [(Waving(), "more often than the exported search can follow"), (Waving(5.0), "jumps at 250000")]
)
def test_a_law_whose_curve_c_cannot_follow_is_refused_in_a_sentence(muscle, said, tmp_path, monkeypatch):
    monkeypatch.setattr(curved, "_MOST_SAMPLES", 20)
    monkeypatch.setattr(curved, "_CONTRACTIONS", 3)
    with pytest.raises(InvalidInput, match=said):
        export_mechanism(tmp_path / "c", Mechanism(Pulleys(0.4, [(0.02,), (-0.02,)], 0.13), muscle))
    assert not (tmp_path / "c").exists()
