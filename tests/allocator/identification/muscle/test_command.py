"""`antagonist fit` as a person meets it."""

import matplotlib as mpl
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from allocator.identification import fit, load_dataset
from allocator.identification.muscle.cli import fit_command
from allocator.identification.muscle.fit import prepared
from allocator.identification.muscle.plotting import plot_isobars
from allocator.identification.muscle.reading import read_samples
from allocator.identification.muscle.samples import joined
from allocator.muscles import MODELS, Muscle, Sarosi2012
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR

app = typer.Typer(pretty_exceptions_enable=False)
app.command("fit")(fit_command)


def run(*arguments):
    return CliRunner().invoke(app, [*map(str, arguments)])


def test_out_of_the_box_it_ranks_all_models_on_a_table_of_the_package():
    result = run()
    assert result.exit_code == 0
    assert all(name in result.output for name in MODELS)
    assert "60 taut samples and 66 slack ones" in result.output
    said = " ".join(result.output.split())
    assert "as the C of an arm's controller needs it: TableMuscle, 2.72 N unseen, the least error of all" in said


def test_one_model_is_fitted_saved_and_drawn(tmp_path):
    result = run("--model", "Sarosi2012", "--out", tmp_path / "my.toml", "--plot", tmp_path / "fit.png")
    assert result.exit_code == 0
    assert "6.20 N RMS" in result.output
    measured = load_dataset("dmsp-20-300-map")
    expected = fit(Sarosi2012, measured.contraction, measured.pressure, measured.force)
    assert Muscle.load(tmp_path / "my.toml") == expected.muscle
    assert (tmp_path / "fit.png").read_bytes().startswith(b"\x89PNG")


def test_one_s_own_file_with_lengths_and_what_is_held(tmp_path):
    path = tmp_path / "mine.csv"
    rows = [f"{300 * (1 - e):.3f};{p};{1000 * p / 5 * (1 - e / 0.25):.3f}" for e in (0.0, 0.1, 0.2) for p in (1, 3, 5)]
    path.write_text("length_mm;pressure_bar;force_N\n" + "\n".join(rows).replace(".", ","), encoding="utf-8")
    result = run(path, "--rest-length", 300, "--model", "Hogan1984", "--hold", "P_max=5e5", "--min-pressure", 2)
    assert result.exit_code == 0
    assert "F_max = 1000 " in result.output
    assert "P_max = 500000 (held)" in result.output
    assert "3 samples left out: pressure below 2 bar" in result.output


def test_the_number_of_samples_is_a_column_and_what_a_model_cannot_take_is_said():
    result = run("dmsp-20-sheet", "--model", "Hildebrandt2005")
    assert result.exit_code == 0
    header, row = (next(line for line in result.output.splitlines() if word in line) for word in (" model ", "Hildebr"))
    assert row.split()[1] == "39"
    assert header.split()[1] == "samples"
    assert "19 samples left out: contraction below 0, where Hildebrandt2005 ends" in result.output


def test_what_was_done_to_the_readings_is_said(tmp_path):
    path = tmp_path / "tension.csv"
    P, eps = (a.ravel() for a in np.meshgrid(np.arange(1, 6), np.arange(26)))
    F = -np.maximum(SAROSI_DMSP_20_400N.force(P * BAR, eps / 100), 0.0)
    rows = "\n".join(f"{e},{p},{f:.3f}" for e, p, f in zip(eps, P, F, strict=True))
    path.write_text("contraction_pct,pressure_bar,force_N\n" + rows, encoding="utf-8")
    result = run(path, "--model", "Sarosi2012", "--zero-noise", 2)
    assert result.exit_code == 0
    assert "the forces are negative where the muscle pulls: taken with the other sign" in result.output
    assert "slack is a force below 6 N, three times the zero noise" in result.output


def forces(path, pressures, offset):
    """Write forces of a known muscle, 1 % and 1.5 N of noise, from a load cell with its own zero."""
    rng = np.random.default_rng(abs(round(offset)))
    P, eps = (a.ravel() for a in np.meshgrid(pressures, np.arange(28.0)))
    F = np.maximum(SAROSI_DMSP_20_400N.force(P * BAR, eps / 100), 0.0)
    F = F * (1 + 0.01 * rng.normal(size=F.size)) + 1.5 * rng.normal(size=F.size) + offset
    rows = "\n".join(f"{e},{p},{f:.3f}" for e, p, f in zip(eps, P, F, strict=True))
    path.write_text("contraction_pct,pressure_bar,force_N\n" + rows, encoding="utf-8")
    return path


def test_several_files_make_one_muscle_each_with_the_zero_of_its_load_cell(tmp_path):
    one, two = forces(tmp_path / "monday.csv", (1, 2, 3, 4), 9.0), forces(tmp_path / "tuesday.csv", (2, 3, 4, 5), -14.0)
    result = run(one, two, "--model", "Sarosi2012", "--out", tmp_path / "my.toml")
    assert result.exit_code == 0
    said = " ".join(result.output.split())
    zeros = [
        float(said.split(f"{name}: slack readings lie round ")[1].split()[0]) for name in ("monday.csv", "tuesday.csv")
    ]
    assert zeros == pytest.approx([9.0, -14.0], abs=0.5)
    errors = [line.split() for line in result.output.splitlines() if "taut samples, " in line and ".csv: " in line]
    assert [words[0] for words in errors] == ["monday.csv:", "tuesday.csv:"]
    assert all(float(words[4]) < 10 and abs(float(words[-2])) < 3 for words in errors)
    found = Muscle.load(tmp_path / "my.toml")
    P, eps = np.meshgrid(np.arange(1, 6) * BAR, np.linspace(0, 0.2, 9))
    np.testing.assert_allclose(found.force(P, eps), SAROSI_DMSP_20_400N.force(P, eps), atol=12)
    assert "data" in (tmp_path / "my.toml").read_text()
    assert "monday.csv, tuesday.csv" in (tmp_path / "my.toml").read_text()
    twice = run(one, one)
    assert "a file is given twice" in str(twice.exception)


def test_files_have_a_hysteresis_each_and_none_between_them(tmp_path):
    """Each file rises; the step back to the next file's beginning is no falling branch."""
    samples = joined({name: read_samples(forces(tmp_path / f"{name}.csv", (3,), 0.0)) for name in "abcdef"})
    assert not any("hysteresis" in note for note in prepared(samples).notes)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--model", "Magic2030"], "unknown model 'Magic2030'; available: AffinePolynomial, "),
        (["--hold", "r0"], "--hold r0: expected NAME=VALUE, such as r0=0.0109"),
        (["--hold", "r0=0.01", "--hold", "r0 = 0.02"], "--hold r0 = 0.02: r0 is given twice"),
        (
            ["--hold", "radius=0.01", "--model", "TonduLopez1995"],
            "there is no parameter 'radius' to hold; there are r0",
        ),
        (["--hold", "r0=nan"], "hold: r0 = nan is not finite"),
        (["--zero-noise", "-2"], "--zero-noise -2: expected 0 to 1e+06 N"),
        (["nowhere.csv"], "nowhere.csv: does not exist"),
        (["--model", "Hogan1984", "--min-pressure", "9"], "no samples are left to fit"),
    ],
)
def test_wrong_input_is_one_sentence(arguments, said):
    result = run(*arguments)
    assert result.exit_code == 1
    assert said in str(result.exception)
    assert "\n" not in str(result.exception)


def test_the_plot_shows_the_data_and_the_model_s_isobars():
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    measured = load_dataset("dmsp-20-300-map")
    found = fit(Sarosi2012, measured.contraction, measured.pressure, measured.force, folds=0)
    axes = plot_isobars(found)
    lines = {line.get_label(): line for line in axes.lines if "bar" in str(line.get_label())}
    assert 5 <= len(lines) <= 9
    percent, F = lines["6.75 bar"].get_data()
    taut = ~np.isnan(F)
    np.testing.assert_allclose(F[taut], found.muscle.force(6.75 * BAR, percent[taut] / 100))
    assert (found.muscle.force(6.75 * BAR, percent[~taut] / 100) < 0).all()
    dots = {
        (round(x, 6), round(y, 6))
        for line in axes.lines
        if line.get_marker() == "o"
        for x, y in zip(*line.get_data(), strict=True)
    }
    assert (round(100 * (1 - 0.296 / 0.3), 6), 1653.5) in dots
    plt.close(axes.figure)


def test_the_errors_of_a_weak_muscle_are_told_apart(tmp_path):
    eps, P = np.meshgrid(np.linspace(0, 0.2, 9), np.linspace(1, 3, 4))
    F = 4 * P * (1 - 3 * eps) + 0.1 * np.sin(40 * eps * P)  # at most 12 N
    rows = "\n".join(f"{e},{p},{f}" for e, p, f in zip(eps.flat, P.flat, F.flat, strict=True))
    path = tmp_path / "weak.csv"
    path.write_text(f"eps [ratio],p [bar],F [N]\n{rows}\n")
    shown = run(str(path), "--model", "Hogan1984").output
    error = next(line for line in shown.splitlines() if line.startswith(" Hogan1984")).split()[2]
    assert len(error.strip("0.")) == 3, "three significant digits"
    assert "[M] is kept" in " ".join(shown.split())
