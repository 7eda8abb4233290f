"""What a fit promises: literature values, inequalities, what is held, what is said."""

import numpy as np
import pytest
from scipy.optimize import curve_fit, minimize

from allocator import AntagonistJoint, Pulley
from allocator.errors import InvalidInput
from allocator.identification import fit, load_dataset
from allocator.muscles import (
    MODELS,
    AffineMuscle,
    Andrikopoulos2016,
    Hildebrandt2005,
    Hogan1984,
    KazemipourKatzschmann2025,
    MartensBoblan2017,
    PolynomialMcKibben,
    Sarosi2012,
    TableMuscle,
    Tondu2021,
    TonduLopez1995,
    monotonicity_failure,
)
from allocator.muscles.catalogue import MARTENS_DMSP_20_300, SAROSI_DMSP_20_400N
from allocator.units import BAR

WORKING = {"pressure_range": (0.95 * BAR, 7 * BAR), "contraction_range": (0.0, 0.3)}


@pytest.fixture(scope="module")
def measured():
    return load_dataset("dmsp-20-300-map")


@pytest.fixture(scope="module")
def sheet():
    return load_dataset("dmsp-20-sheet")


def fitted(model, samples, **options):
    return fit(model, samples.contraction, samples.pressure, samples.force, **options)


# --- literature -----------------------------------------------------------------------------------------------------


def test_the_sarosi_form_follows_the_measured_map_to_6_3_n(measured):
    found = fitted(Sarosi2012, measured)
    assert found.n_taut == 60
    assert found.rms <= 6.3
    assert found.monotone


def test_the_sarosi_form_follows_the_data_sheet_to_7_n(sheet):
    found = fitted(Sarosi2012, sheet, **WORKING)
    assert found.n_taut == 29
    assert found.rms <= 7.0
    assert found.monotone


def test_the_sarosi_form_fitted_to_the_data_sheet_stiffens_the_joint_as_mathematics_section_8_says(sheet):
    muscle = fitted(Sarosi2012, sheet, **WORKING).muscle
    joint = AntagonistJoint(Pulley(0.40, 0.02, 0.1375), muscle, muscle)
    P = np.arange(1, 6) * BAR
    np.testing.assert_allclose(joint.stiffness(0.0, P, P), [1.93, 3.54, 5.16, 6.78, 8.39], atol=0.03)


def test_martens_boblan_fitted_is_better_than_its_published_constants(measured):
    assert fitted(MartensBoblan2017, measured).rms < 14.6


def test_the_fit_of_a_smooth_law_is_that_of_scipy_s_curve_fit(measured):
    found = fitted(Sarosi2012, measured, pressure_range=(2 * BAR, 7 * BAR))
    use = (measured.pressure >= 2 * BAR) & (measured.force > 0)
    eps, P, F = measured.contraction[use], measured.pressure[use] / BAR, measured.force[use]

    def law(x, c1, c2, c3, c4, c5, c6):
        eps, P = x
        return (c1 * np.exp(c6 * eps) + c2 * eps + c3) * P - c4 * np.exp(c6 * eps) + c5

    c, covariance = curve_fit(law, (eps, P), F, p0=(0, -800, 260, -300, -300, -30), maxfev=20000)
    pulls = fit(Sarosi2012, eps, P * BAR, F)  # the taut samples alone
    theirs = np.array([*(c[:3] / BAR), *c[3:]])
    ours = np.array(list(pulls.muscle.parameters.values()))
    np.testing.assert_allclose(ours, theirs, rtol=1e-4)
    unit = np.array([1 / BAR] * 3 + [1] * 3)
    np.testing.assert_allclose(list(pulls.standard_deviations.values()), np.sqrt(np.diag(covariance)) * unit, rtol=1e-3)
    assert found.rms >= pulls.rms  # the slack samples cost something


# --- slack samples --------------------------------------------------------------------------------------------------


def test_slack_samples_are_inequalities_and_not_zeros(measured):
    as_inequalities = fitted(Hildebrandt2005, measured)
    assert as_inequalities.slack.sum() == 66
    F = as_inequalities.muscle.force(measured.pressure, measured.contraction)[as_inequalities.slack]
    assert F.min() < -100  # free to be far below zero
    assert F.max() < 0.02 * as_inequalities.samples.full_scale


def test_a_linear_law_with_inequalities_ends_at_the_minimum_that_bfgs_finds(measured):
    found = fitted(Hildebrandt2005, measured, folds=0)
    eps, P, F = measured.contraction, measured.pressure, measured.force
    columns = [P, P * eps, P * eps**2, -np.ones_like(P), -eps, -(eps**2), -(eps**3), -(eps ** (2 / 3))]
    basis = np.stack(columns, axis=1)
    basis /= np.linalg.norm(basis[F > 0], axis=0)

    def cost(p):
        r = np.where(F > 0, basis @ p - F, np.maximum(basis @ p, 0))
        return r @ r, 2 * basis.T @ np.where((F > 0) | (basis @ p > 0), r, 0)

    theirs = minimize(cost, np.zeros(8), jac=True, method="BFGS", options={"gtol": 1e-8, "maxiter": 20000}).fun
    assert found.residuals() @ found.residuals() == pytest.approx(theirs, rel=1e-4)


def test_a_slack_sample_that_the_model_respects_costs_nothing():
    muscle = SAROSI_DMSP_20_400N
    P, eps = (a.ravel() for a in np.meshgrid(np.linspace(1, 5, 9) * BAR, np.linspace(0.01, 0.25, 9)))
    F = np.maximum(muscle.force(P, eps), 0.0)
    found = fit(Sarosi2012, eps, P, F)
    assert (found.slack.sum(), found.n_taut) == ((F == 0).sum(), (F > 0).sum())
    assert found.rms < 1e-5
    for name, value in muscle.parameters.items():
        assert found.muscle.parameters[name] == pytest.approx(value, rel=1e-5)


# --- what is held, weighed, left out --------------------------------------------------------------------------------


def test_what_is_held_stays_and_has_no_variance(measured):
    found = fitted(Andrikopoulos2016, measured, hold={"r0": 0.0109, "alpha0": 0.45}, folds=0)
    assert found.muscle.parameters["r0"] == 0.0109
    assert found.muscle.parameters["alpha0"] == 0.45
    assert set(found.free) == {"k_inf", "k_1", "P_k", "q"}
    assert found.standard_deviations["r0"] == 0
    assert found.standard_deviations["k_inf"] > 0


def test_a_muscle_that_is_wholly_held_is_only_judged(measured):
    published = MARTENS_DMSP_20_300.parameters
    found = fitted(MartensBoblan2017, measured, hold=published)
    assert found.muscle.parameters == published
    assert (found.free, found.rank) == ((), 0)
    assert found.rms == pytest.approx(14.6, abs=0.2)


def test_holding_what_the_model_does_not_have_names_what_it_has(measured):
    with pytest.raises(InvalidInput, match="Hogan1984 has no parameter 'r0'; it has F_max, eps_max, P_max"):
        fitted(Hogan1984, measured, hold={"r0": 0.01})


def test_a_scale_is_held_at_the_highest_pressure_unless_told_otherwise(measured):
    for model in (Hogan1984, KazemipourKatzschmann2025):
        assert fitted(model, measured, folds=0).muscle.parameters["P_max"] == 6.75 * BAR
        other = fitted(model, measured, hold={"P_max": 5 * BAR}, folds=0)
        np.testing.assert_allclose(
            other.muscle.force(3 * BAR, 0.1), fitted(model, measured, folds=0).muscle.force(3 * BAR, 0.1), rtol=1e-6
        )


def test_a_sample_of_weight_zero_is_not_there(measured):
    weights = np.where(measured.pressure > 5 * BAR, 0.0, 1.0)
    weighted = fitted(TonduLopez1995, measured, weights=weights, folds=0).muscle
    fewer = fitted(TonduLopez1995, measured, pressure_range=(0, 5 * BAR), folds=0).muscle
    assert weighted.r0 == pytest.approx(fewer.r0, rel=1e-6)
    assert weighted.alpha0 == pytest.approx(fewer.alpha0, rel=1e-6)


def test_a_sample_of_weight_two_counts_twice(measured):
    use = measured.force > 0
    eps, P, F = measured.contraction[use], measured.pressure[use], measured.force[use]
    twice = np.arange(F.size) < 20
    heavy = fit(Hildebrandt2005, eps, P, F, weights=1.0 + twice, folds=0).muscle
    doubled = [np.concatenate([a, a[twice]]) for a in (eps, P, F)]
    for name, value in fit(Hildebrandt2005, *doubled, folds=0).muscle.parameters.items():
        assert heavy.parameters[name] == pytest.approx(value, rel=1e-6)


def test_what_is_left_out_is_counted_with_the_reason(sheet):
    found = fitted(Hildebrandt2005, sheet, pressure_range=(0.95 * BAR, 5.5 * BAR))
    assert found.samples.dropped == {
        "pressure below 0.95 bar": int((sheet.pressure < 0.95 * BAR).sum()),
        "pressure above 5.5 bar": int((sheet.pressure > 5.5 * BAR).sum()),
        "contraction below 0, where Hildebrandt2005 ends": int(
            ((sheet.contraction < 0) & (sheet.pressure > 0.95 * BAR) & (sheet.pressure < 5.5 * BAR)).sum()
        ),
    }
    assert found.samples.n + sum(found.samples.dropped.values()) == sheet.n


# --- what is said ---------------------------------------------------------------------------------------------------


def test_errors_are_over_the_taut_samples(measured):
    found = fitted(Sarosi2012, measured)
    taut = measured.force > 0
    error = (found.muscle.force(measured.pressure, measured.contraction) - measured.force)[taut]
    assert found.rms == pytest.approx(np.sqrt(np.mean(error**2)))
    assert found.max_error == pytest.approx(np.abs(error).max())
    assert found.rms_percent == pytest.approx(100 * found.rms / 1653.5)
    assert found.max_error_percent == pytest.approx(100 * found.max_error / 1653.5)
    assert sum(level.samples for level in found.levels) == 60
    assert np.sqrt(sum(n * rms**2 for _, n, _, rms in found.levels) / 60) == pytest.approx(found.rms)
    assert [level.pressure for level in found.levels] == sorted({*measured.pressure[taut]})


def test_many_different_pressures_are_put_into_classes():
    rng = np.random.default_rng(1)
    P, eps = rng.uniform(1, 5, 300) * BAR, rng.uniform(0, 0.15, 300)
    found = fit(Hogan1984, eps, P, SAROSI_DMSP_20_400N.force(P, eps))
    assert 5 <= len(found.levels) <= 10
    assert sum(level.samples for level in found.levels) == found.n_taut


def test_cross_validation_is_what_leaving_parts_out_gives(measured):
    """Two parts, done by hand with the linear law."""
    found = fitted(Hildebrandt2005, measured, pressure_range=(2.5 * BAR, 7 * BAR), folds=2)
    use = found.samples.force > 0
    eps, P, F = (a[use] for a in (found.samples.contraction, found.samples.pressure, found.samples.force))
    part = np.random.default_rng(0).permutation(np.arange(F.size) % 2)
    slack = [a[~use] for a in (found.samples.contraction, found.samples.pressure, found.samples.force)]
    errors = []
    for i in (0, 1):
        kept = [np.concatenate([a[part != i], s]) for a, s in zip((eps, P, F), slack, strict=True)]
        muscle = fit(Hildebrandt2005, *kept, folds=0).muscle
        errors.append((muscle.force(P, eps) - F)[part == i])
    assert found.cross_validated == pytest.approx(np.sqrt(np.mean(np.concatenate(errors) ** 2)), rel=1e-6)
    assert found.cross_validated > found.rms


def test_a_fit_that_breaks_monotonicity_says_where(measured):
    found = fitted(PolynomialMcKibben, measured, folds=0)
    assert not found.monotone
    assert any(
        w.startswith("[M] fails, so that more pressure does not always pull more and stiffen: F_Pε = 0 everywhere")
        for w in found.warnings
    )
    wrong = Hildebrandt2005(2e-3, 5e-3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # stiffens as pressure falls
    assert monotonicity_failure(wrong, 5 * BAR, (0.0, 0.3)).startswith("F_Pε >= 0 on 100.0 % of the taut domain")
    assert "0.06–5.00 bar and ε = 0.004–0.300" in monotonicity_failure(wrong, 5 * BAR, (0.0, 0.3))


def test_a_muscle_that_is_never_taut_says_so():
    slack = Hogan1984(-100.0, 0.3, 5 * BAR)
    assert monotonicity_failure(slack, 5 * BAR, (0.0, 0.25)) == "no point of the domain is taut"


def test_a_parameter_that_ends_at_its_limit_is_named(measured):
    found = fitted(MODELS["ChouHannaford1996"], measured, folds=0)
    assert any(w.startswith("t ended at the limit of its search") for w in found.warnings)
    assert found.standard_deviations["t"] == 0


def test_the_fit_does_not_depend_on_the_order_of_the_samples(measured):
    order = np.random.default_rng(2).permutation(measured.n)
    shuffled = fit(Tondu2021, *(a[order] for a in (measured.contraction, measured.pressure, measured.force)), folds=0)
    assert shuffled.rms == pytest.approx(fitted(Tondu2021, measured, folds=0).rms, rel=1e-6)


def test_a_fit_is_a_value_and_the_same_every_time(measured):
    found = fitted(Sarosi2012, measured)
    assert found.muscle == fitted(Sarosi2012, measured).muscle
    with pytest.raises(AttributeError):
        found.rms = 0.0
    with pytest.raises(ValueError, match="read-only"):
        found.samples.force[0] = 1.0


def test_one_s_own_model_is_fitted_from_a_start(measured):
    from dataclasses import dataclass

    @dataclass(frozen=True)
    class Straight(AffineMuscle):
        """F = P (a - b ε) - c ε"""

        citation = "this test"
        a: float
        b: float
        c: float

        def A(self, eps):
            return self.a - self.b * eps

        def B(self, eps):
            return -self.c * eps

    with pytest.raises(InvalidInput, match="Straight does not say from where to search; pass start="):
        fitted(Straight, measured)
    found = fitted(Straight, measured, start=Straight(1e-3, 1e-3, 10.0))
    same = fitted(Straight, measured, start=Straight(3e-3, 0.0, 0.0))
    assert found.rms == pytest.approx(same.rms, rel=1e-6)
    assert found.rms < fitted(Hogan1984, measured).rms  # which is Straight with c = 0


def test_more_knots_in_a_table_follow_closer(measured):
    knots = np.linspace(0.0133, 0.21, 6)
    more = fitted(TableMuscle, measured, start=TableMuscle(knots, (0,) * 6, (0,) * 6), folds=0)
    fewer = fitted(TableMuscle, measured, start=TableMuscle(knots[[0, 1, 3, 5]], (0,) * 4, (0,) * 4), folds=0)
    assert len(more.free) == 12
    assert more.rms < fewer.rms


# --- bad input ------------------------------------------------------------------------------------------------------

GOOD = (np.linspace(0.01, 0.2, 12), np.tile([1.0, 3.0, 5.0], 4) * BAR, np.linspace(900, 50, 12))


def changed(place, array):
    return tuple(array if i == place else a for i, a in enumerate(GOOD))


@pytest.mark.parametrize(
    ("model", "samples", "said"),
    [
        (Sarosi2012, tuple(a[:5] for a in GOOD), "5 taut samples cannot determine the 6 parameters of Sarosi2012 (c1,"),
        (Hogan1984, changed(1, np.full(12, 3 * BAR)), "all taut samples are at one pressure, 3 bar"),
        (Hogan1984, changed(2, np.append(GOOD[2][:-1], np.nan)), "force[11] = nan is not finite"),
        (Hogan1984, changed(0, 100 * GOOD[0]), "was percent meant for the ratio"),
        (Hogan1984, changed(1, GOOD[1] / BAR), "if bar was meant, multiply by 1e5"),
        (Hogan1984, changed(1, GOOD[1][:-1]), "shapes do not broadcast"),
        (Hogan1984, changed(2, -GOOD[2]), "0 taut samples cannot determine"),
        (Hogan1984, changed(1, GOOD[1] - 1.5 * BAR), "below the atmosphere"),
        (Hogan1984, changed(1, GOOD[1] - 1 * BAR), "without pressure a muscle pulls only when stretched"),
        (Hogan1984, changed(2, ["a"] * 12), "is not a number"),
    ],
)
def test_bad_samples_are_one_clear_sentence(model, samples, said):
    with pytest.raises(InvalidInput) as refusal:
        fit(model, *samples)
    assert said in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_negative_weight_is_refused():
    with pytest.raises(InvalidInput, match=r"weights = -1 has to be at least 0"):
        fit(Hogan1984, *GOOD, weights=-1.0)


def test_a_range_that_leaves_nothing_is_refused():
    with pytest.raises(InvalidInput, match="no samples are left"):
        fit(Hogan1984, *GOOD, pressure_range=(6 * BAR, 7 * BAR))
