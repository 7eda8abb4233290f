"""The exported governor says what Python's says, in both precisions and under sanitizers."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from typer.testing import CliRunner

from allocator.errors import InvalidInput, MissingBackend
from allocator.mechanism import machines
from allocator.units import BAR
from mpc.cli import app
from mpc.export.governor import export_governor
from mpc.governor import GovernorStatus, Interval, PressureGovernor

from ...rigs import toolchain as tools
from ...rigs.needs import needs

pytestmark = pytest.mark.compiles

needs_gcc = needs("gcc")
ARM = machines.arm26()


@cache
def governor(unsure=False):
    """The governor of arm26 with gas, exact or with numbers in intervals."""
    exact = PressureGovernor(ARM, 0.01, 20 * BAR, (0.12, 0.04), damping=0.1, lag=0.02, max_energy=2.0, gas=True)
    intervals = {
        "inertia": Interval((0.11, 0.036), (0.13, 0.044)),
        "damping": Interval(0.08, 0.12),
        "lag": Interval(0.015, 0.025),
        "strength": Interval(0.95, 1.05),
    }
    return replace(exact, **intervals) if unsure else exact


REPLAY = """
#include <stdio.h>
#include "antagonist_governor.h"
static ant_memory memory;
int main(int argc, char **argv) {
    (void)argc;
    FILE *in = fopen(argv[1], "r");
    double read;
    ant_real row[2 * ANT_JOINTS + 3 * ANT_MUSCLES], safe[ANT_MUSCLES];
    int got = 0;
    while (fscanf(in, "%lf", &read) == 1) {
        row[got++] = (ant_real)read;
        if (got < 2 * ANT_JOINTS + 3 * ANT_MUSCLES) continue;
        got = 0;
        const ant_real *P = row + 2 * ANT_JOINTS;
        printf("%d", ant_govern(row, row + ANT_JOINTS, P, P + ANT_MUSCLES, P + 2 * ANT_MUSCLES, safe, &memory));
        for (int j = 0; j < ANT_MUSCLES; j++) printf(" %.17g", (double)safe[j]);
        printf("\\n");
    }
    fclose(in);
    return 0;
}
"""


def commands(N):
    """Rows (q, ω, P, the last command, the next): safe, too fast, too much, no numbers."""
    rng = np.random.default_rng(0)
    q, omega = rng.uniform(-0.9, 0.9, (N, 2)), rng.normal(0, 2.5, (N, 2))
    P = rng.uniform(*ARM.pressure_box(q))
    command = P + rng.choice([0.1, 1.0, 1e3], (N, 1)) * rng.normal(0, 1, P.shape) * BAR
    command[::20] = np.nan
    return np.concatenate([q, omega, P, P, command], axis=1).astype(np.float32).astype(float)


@pytest.mark.slow
@pytest.mark.tools
@needs_gcc
@pytest.mark.parametrize(("precision", "flags", "near"), [("double", tools.SANITISED, 1e-3), ("single", (), 500.0)])
@pytest.mark.parametrize("unsure", [False, True], ids=["exact", "intervals"])
def test_c_governs_as_python_does(tmp_path, unsure, precision, flags, near):
    out = export_governor(tmp_path / "c", governor(unsure), precision=precision)
    rows = commands(60)
    (out / "replay.c").write_text(REPLAY)
    (out / "rows.txt").write_text("\n".join(" ".join(map(repr, row)) for row in rows.tolist()))
    program = tools.compiled(out, out / "replay.c", "replay", *flags)
    said = np.array([line.split() for line in tools.run(program, str(out / "rows.txt")).splitlines()], float)
    q, omega, P, last, command = np.split(rows, np.cumsum([2, 2, 6, 6]), axis=1)
    safe, status = governor(unsure).govern(q, omega, P, command, last)
    assert {*GovernorStatus} & {*status.tolist()} >= {-1, 0, 1, 2}
    same = said[:, 0] == status
    assert same.all() if precision == "double" else same.mean() > 0.95  # rounding decides where a rollout just stays
    assert np.abs(said[same, 1:] - safe[same]).max(axis=1) == pytest.approx(0, abs=near)


@pytest.mark.slow
@pytest.mark.tools
@needs_gcc
def test_the_demonstration_prints_what_its_readme_says(tmp_path):
    out = export_governor(tmp_path / "c", governor())
    printed = tools.run(tools.compiled(out, out / "main.c", "demonstration")).strip()
    assert printed in (out / "README.md").read_text()
    assert "status 2" in printed or "status 1" in printed


def test_a_command_exports_the_governor_of_a_machine(tmp_path):
    made = CliRunner().invoke(app, ["export", "governor", "--out", str(tmp_path / "c"), "--machine", "arm26"])
    assert made.exit_code == 0, made.output
    assert "ant_govern" in (tmp_path / "c" / "README.md").read_text()
    assert CliRunner().invoke(app, ["init", str(tmp_path / "arm.toml"), "--machine", "arm26"]).exit_code == 0
    made = ["export", "governor", "--out", str(tmp_path / "e"), "--machine", str(tmp_path / "arm.toml")]
    assert CliRunner().invoke(app, made).exit_code == 0
    same = [(tmp_path / out / "src" / "governor.h").read_text() for out in ("c", "e")]
    assert same[0] == same[1]
    wrong = CliRunner().invoke(app, ["export", "governor", "--out", str(tmp_path / "d")])
    assert "takes an arm of several joints" in str(wrong.exception)
    assert not (tmp_path / "d").exists()


def test_the_readme_lists_unlike_lags_and_intervals_in_their_order(tmp_path):
    unlike = replace(governor(), lag=(0.06, 0.12, 0.06, 0.06, 0.1, 0.1), damping=Interval((0.1, 0.2), (0.1, 0.3)))
    said = (export_governor(tmp_path / "c", unlike) / "README.md").read_text()
    assert "strength 1; damping 0.1, 0.2 to 0.3 N·m·s/rad; lag 0.06, 0.12, 0.06, 0.06, 0.1, 0.1 s" in said


def test_what_is_no_governor_is_refused(tmp_path):
    with pytest.raises(InvalidInput, match="expected a PressureGovernor"):
        export_governor(tmp_path / "c", ARM)
    with pytest.raises(MissingBackend, match="half"):
        export_governor(tmp_path / "c", governor(), precision="half")
    assert not (tmp_path / "c").exists()
