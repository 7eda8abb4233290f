"""The gas from a log: what generated it comes back, with ± that are true, and what a log cannot tell is not told."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import BAR, DEG, InvalidInput
from allocator.identification.trapped_gas import at_rest, fit_gas
from allocator.joint.antagonist import report_joint
from allocator.joint.gas import Gas
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N

CM3 = 1e-6
KAPPA, V0 = 1.27, (150 * CM3, 130 * CM3)
NAIVE = report_joint(SAROSI_DMSP_20_400N)  # its own κ and V_0 are others


def true(joint=NAIVE):
    one, two = (
        replace(muscle, rest_volume=V, tube_volume=0.0)
        for muscle, V in zip((joint.agonist, joint.antagonist), V0, strict=True)
    )
    return replace(joint, agonist=one, antagonist=two, gas=Gas(KAPPA))


def log(amplitude, rests=((3 * BAR, 3 * BAR),), noise=0.02 * BAR, seed=0, joint=NAIVE, leak=0.0):
    """θ, P1, P2 and the rests of a joint turned by hand at 0.2 Hz, 20 s a rest, a sample every 20 ms.

    The pressures are solved for from (P + p_a) V^κ; a leak takes that share of it a second.
    """
    joint, rng = true(joint), np.random.default_rng(seed)
    t = 0.02 * np.arange(1000)
    theta = amplitude * np.sin(2 * np.pi * 0.2 * t) * np.minimum(1, t / 2)
    columns = []
    for number, start in enumerate(rests):
        P = []
        for rest, side, begun in zip(joint.sides(0.0), joint.sides(theta), start, strict=True):
            constant = (begun + joint.gas.atmosphere) * rest.volume(begun) ** KAPPA * np.exp(-leak * t)
            now = np.full(t.size, begun)
            for _ in range(50):
                now = constant / side.volume(now) ** KAPPA - joint.gas.atmosphere
            P.append(now + noise * rng.standard_normal(t.size))
        columns.append([theta, *P, np.full(t.size, number)])
    return np.concatenate(columns, axis=1)


def slope(joint, P):
    """κ/V^eff of both muscles at θ = 0."""
    return [KAPPA / side.effective_volume(P) for side in true(joint).sides(0.0)]


@pytest.mark.parametrize("leak", [0.0, 0.002])
def test_an_exact_log_gives_back_the_gas_that_made_it(leak):
    fit = fit_gas(NAIVE, *log(50 * DEG, noise=0.0, leak=leak))
    for gas, V, expected in zip((fit.agonist, fit.antagonist), V0, slope(NAIVE, 3 * BAR), strict=True):
        assert gas.kappa.value == pytest.approx(KAPPA, rel=1e-4)
        assert gas.rest_volume.value == pytest.approx(V, rel=1e-3)
        assert gas.stiffening.value == pytest.approx(expected, rel=2e-3)
    fitted = fit.fitted()
    assert fitted.stiffness(0.2, 3e5, 2e5, valves="shut") == pytest.approx(
        true().stiffness(0.2, 3e5, 2e5, valves="shut"), rel=1e-4
    )


@pytest.mark.slow
def test_the_uncertainties_are_those_of_the_noise():
    """Of 150 logs the errors of both muscles are as large as said."""
    errors = []
    for seed in range(150):
        fit = fit_gas(NAIVE, *log(60 * DEG, ((2 * BAR, 2 * BAR), (4 * BAR, 4 * BAR)), seed=seed))
        for gas, V in zip((fit.agonist, fit.antagonist), V0, strict=True):
            true_values = KAPPA / (V + gas.swell), KAPPA, V
            found = gas.ratio, gas.kappa, gas.rest_volume
            errors.append([(one.value - value) / one.std for one, value in zip(found, true_values, strict=True)])
    assert (np.abs(np.mean(errors, axis=0)) < 0.2).all()
    assert (np.abs(np.std(errors, axis=0) - 1) < 0.2).all()


def test_a_small_angle_tells_only_the_relation_of_kappa_and_volume_and_says_so():
    fit = fit_gas(NAIVE, *log(10 * DEG))
    assert fit.agonist.kappa is fit.agonist.rest_volume is fit.kappa is None
    wanted = slope(NAIVE, 3 * BAR)[0]
    assert abs(fit.agonist.stiffening.value - wanted) < 4 * fit.agonist.stiffening.std < 0.1 * wanted
    assert "not told apart" in fit.message
    with pytest.raises(InvalidInput, match="has to be given: this log tells only"):
        fit.fitted()
    volume = fit.agonist.volume_for(KAPPA)
    assert abs(volume.value - V0[0]) < 4 * volume.std
    assert fit.fitted(KAPPA).agonist.rest_volume == volume.value


def test_two_cocontractions_tell_them_apart_where_the_volume_depends_on_the_pressure():
    """The report's muscle swells less at 4 bar than at 1: by a small angle at one of them nothing is told."""
    joint = report_joint()
    one, two = (
        fit_gas(joint, *log(12 * DEG, rests, noise=1e3, joint=joint))
        for rests in (((1 * BAR, 1 * BAR),), ((1 * BAR, 1 * BAR), (4 * BAR, 4 * BAR)))
    )
    assert one.kappa is None
    assert abs(two.kappa.value - KAPPA) < 4 * two.kappa.std < 0.5
    assert abs(two.agonist.rest_volume.value - V0[0]) < 4 * two.agonist.rest_volume.std


def test_rests_are_where_commands_stand_still_within_the_dead_band():
    u = np.full((8, 2), 3e5)
    u[4:] = 2e5
    P = np.array([3e5, 3.02e5, 3.08e5, 3e5, 2.9e5, 2e5, 2e5, 2.04e5])
    np.testing.assert_array_equal(at_rest(u, P, u[:, 1], 0.1 * BAR), [0, 0, -1, 1, -1, 2, 2, 2])
    with pytest.raises(InvalidInput, match="dead_band = 0 Pa"):
        at_rest(u, P, P, 0.0)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda c: (0 * c[0], *c[1:]), "was not turned"),
        (lambda c: (c[0], c[1], c[2], c[3] - 5), "only 0 samples"),
        (lambda c: (c[0][:50], *c[1:]), "one length"),
        (lambda c: (c[0], c[1] / 1e5, *c[2:]), "bar"),
    ],
)
def test_a_log_that_tells_nothing_is_refused(change, said):
    with pytest.raises(InvalidInput, match=said):
        fit_gas(NAIVE, *change(log(30 * DEG)))
