"""The exported allocation of mechanisms says what Python's says, in both precisions and under sanitizers."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

from allocator import Limits, Status, allocate
from allocator.errors import InvalidInput, MissingBackend
from allocator.mechanism import Mechanism, Tables, machines
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N, TONDU_LOPEZ_LAAS_ARM
from allocator.units import BAR
from mpc.export.mechanism import export_mechanism

from ...rigs import toolchain as tools
from ...rigs.needs import needs
from ...rigs.two_links import two_links

MAIN = Path(tools.__file__).parent / "c" / "replay" / "mechanism.c"
needs_gcc = needs("gcc")
ARM = machines.arm26()
TABLE = Tables(0.4, [np.linspace(-1, 1, 9)], 0.345 + 0.02 * np.linspace(-1, 1, 9)[:, None] * [-1, 1])


def questions(mechanism, N, seed=0, dtype=float):
    """Rows for C, and Python's answers: reachable and not, with and without limits on forces and steps."""
    rng = np.random.default_rng(seed)
    n, m = mechanism.n, mechanism.m
    rows, answers = [], []
    for k, (priority, least, greatest, slew, free) in enumerate(CASES):
        q = rng.uniform(-0.45, 0.45, n).astype(dtype).astype(float)
        lo, hi = mechanism.pressure_box(q)
        P = rng.uniform(lo, hi, (N, m))
        far = np.where(np.arange(N) % 2, rng.uniform(1, 4, N), 1.0)
        T = (mechanism.torque(q, P) * far[:, None]).astype(dtype).astype(float)
        K = np.array(mechanism.stiffness(q, P)) * np.where(np.arange(N) % 3, 1.0, 1.7)[:, None, None]
        K = K.astype(dtype).astype(float)
        T, K, P = (a[np.linalg.eigvalsh(K)[:, 0] > 0.05] for a in (T, K, P))  # others are none to ask for
        now, step = (P + rng.uniform(-1, 1, P.shape) * BAR).astype(dtype).astype(float), 0.3 * BAR
        now = np.clip(now, 0, 5 * BAR)
        known = slew or k % 2
        limits = Limits(least, greatest, previous=now if known else None, max_step=step if slew else None)
        triangle = K[:, *mechanism.upper_triangle]
        if free:
            triangle[:, mechanism.upper_triangle[0] != mechanism.upper_triangle[1]] = np.nan
        a = allocate(q, K[:, range(n), range(n)] if free else K, T, joint=mechanism, limits=limits, priority=priority)
        ends = [-np.inf if least is None else least, np.inf if greatest is None else greatest]
        tail = [step if slew else np.inf, bool(known), k % 3 == 2, priority != "torque"]
        for i in range(len(T)):
            rows.append([*q, *T[i], *triangle[i], *ends, *now[i], *tail])
            answers.append([*a.P[i], *a.T[i], *a.K[i][mechanism.upper_triangle], a.kkt_residual[i], a.status[i]])
    return np.array(rows, float), np.array(answers)


CASES = [
    (priority, least, greatest, slew, free)
    for priority in ("torque", "stiffness")
    for least, greatest in ((0.0, None), (None, None), (40.0, 350.0))
    for slew in (False, True)
    for free in (False, True)
]


def answered(program, rows, *arguments):
    """What the C program says of the rows."""
    text = "\n".join(" ".join(f"{value:.17g}" for value in row) for row in rows)
    done = subprocess.run([program, *arguments], input=text, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return np.array([[float(value) for value in line.split()] for line in done.stdout.splitlines()])


def differences(mechanism, made, expected):
    """Pressures in fractions of the supply, torques and stiffness of their greatest, and equal statuses, as a share."""
    m = mechanism.m
    P = np.abs(made[:, :m] - expected[:, :m]).max(axis=1) / mechanism.pressure_limits[1]
    given = np.abs(made[:, m:-2] - expected[:, m:-2]).max(axis=1) / np.abs(expected[:, m:-2]).max()
    return P, given, np.mean(made[:, -1] == expected[:, -1])


@needs_gcc
@pytest.mark.tools
@pytest.mark.slow
@pytest.mark.parametrize("make", [machines.arm26, machines.leg37, two_links], ids=["arm26", "leg37", "sites"])
def test_c_and_python_give_the_same_pressures_and_statuses(make, tmp_path):
    mechanism = make()
    out = export_mechanism(tmp_path / "c", mechanism)
    rows, expected = questions(mechanism, 30)
    made = answered(tools.compiled(out, MAIN, "replay"), rows)
    P, given, same = differences(mechanism, made, expected)
    assert P.max() < 1e-9
    assert given.max() < 1e-9
    assert same == 1.0
    assert made[:, -2].max() < 1e-9  # the residuals that C computes
    assert {0, 1, 2, 3} <= {*expected[:, -1]}
    checked = answered(tools.compiled(out, MAIN, "sanitised", *tools.SANITISED), rows[::7])
    assert checked == pytest.approx(made[::7], rel=1e-9, abs=1e-6)


@needs_gcc
@pytest.mark.tools
@pytest.mark.slow
def test_single_precision_gives_what_double_gives_to_its_digits(tmp_path):
    out = export_mechanism(tmp_path / "c", ARM, precision="single")
    rows, expected = questions(ARM, 60, seed=1, dtype=np.float32)
    made = answered(tools.compiled(out, MAIN, "replay", "-O2", "-Wdouble-promotion"), rows)
    P, given, same = differences(ARM, made, expected)
    assert np.isin(made[:, -1], Status).all()
    assert (made[:, -1] != Status.SOLVER_FAILED).all()
    assert given.max() < 1e-4
    assert np.quantile(P, 0.99) < 1e-4
    assert same > 0.97  # what is missed by less than single precision can tell is met
    lo, hi = 0.0, 5 * BAR
    assert ((made[:, :6] >= lo) & (made[:, :6] <= hi)).all()


@needs_gcc
@pytest.mark.tools
def test_senseless_questions_are_answered_within_the_supply(tmp_path):
    out = export_mechanism(tmp_path / "c", ARM)
    rows, _ = questions(ARM, 1, seed=2)
    good = rows[0]
    wrong = []
    places = {"q": 0, "T": 2, "K11": 4, "least force": 7, "greatest force": 8, "now": 9, "step": 15, "priority": 18}
    for place in places.values():
        for value in (np.nan, np.inf, -np.inf, 1e300, -1.0):
            row = good.copy()
            row[place] = value
            wrong.append(row)
    made = answered(
        tools.compiled(out, MAIN, "sanitised", *tools.SANITISED, "-fno-sanitize=float-cast-overflow"), wrong
    )
    assert ((made[:, :6] >= 0) & (made[:, :6] <= 5 * BAR)).all()
    assert (made[[0, 1, 2, 5, 6, 7, 25, 26, 27], -1] == -1).all()  # q, T and the pressures now that are not finite
    indefinite = good.copy()
    indefinite[4:7] = 5.0, 20.0, 5.0
    assert answered(out / "sanitised", [indefinite])[0, -1] == -1


@needs_gcc
@pytest.mark.tools
def test_the_demonstration_prints_what_the_readme_says(tmp_path):
    out = export_mechanism(tmp_path / "c", machines.arm48())
    program = tools.compiled(out, out / "main.c", "demonstration")
    shown = (out / "README.md").read_text().split("```text\n")[1].split("```")[0]
    assert tools.run(program) == shown


@pytest.mark.parametrize(
    ("mechanism", "options", "error", "said"),
    [
        (Mechanism(TABLE, SAROSI_DMSP_20_400N), {}, InvalidInput, "Tables"),
        ("arm26", {}, InvalidInput, "expected a Mechanism"),
        (machines.arm26().with_muscles(TONDU_LOPEZ_LAAS_ARM), {}, InvalidInput, "not affine"),
        (ARM, {"precision": "half"}, MissingBackend, "precision"),
    ],
)
def test_what_cannot_be_exported_is_said_in_a_sentence(mechanism, options, error, said, tmp_path):
    with pytest.raises(error, match=said):
        export_mechanism(tmp_path / "c", mechanism, **options)
    assert not (tmp_path / "c").exists()


@pytest.mark.tools
def test_the_command_exports_a_mechanism_by_its_name(tmp_path):
    from typer.testing import CliRunner

    from mpc.cli import app

    made = CliRunner().invoke(app, ["export", "allocation", "--machine", "leg37", "--out", str(tmp_path / "c")])
    assert made.exit_code == 0, made.output
    assert "#define ANT_MUSCLES 7" in (tmp_path / "c" / "antagonist_config.h").read_text()
    file = tmp_path / "leg.toml"
    assert CliRunner().invoke(app, ["init", str(file), "--machine", "leg37"]).exit_code == 0
    file.write_text(file.read_text().partition("[bodies]")[0])
    asked = ["--machine", str(file), "--out", str(tmp_path / "d")]
    assert CliRunner().invoke(app, ["export", "allocation", *asked]).exit_code == 0
    refused = CliRunner().invoke(app, ["export", "firmware", *asked[:-1], str(tmp_path / "e")])
    assert "the table [bodies] is missing" in str(refused.exception)
