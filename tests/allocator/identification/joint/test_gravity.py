"""Rests of a pendulum written as formulas: its muscles are found without its gravity, and its zero is held."""

import numpy as np
import pytest
from scipy.optimize import brentq

from allocator.errors import InvalidInput
from allocator.files.toml import Table
from allocator.identification import fit_joint
from allocator.identification.joint.filing import Said
from allocator.joint.geometry import Pulley
from allocator.joint.gravity import Gravity
from allocator.machine_file import load_joint
from allocator.muscles import storage
from allocator.units import BAR, DEG

RADIUS, LENGTH, EPS0 = 0.02, 0.3, 0.12
HANGING = Gravity(1.5, 0.3)
ZERO = 3 * DEG


def _force(P, eps):
    return P * (2.8e-3 - 1.1e-2 * eps) - 150.0 - 900.0 * eps


def _torque(theta, P1, P2):
    turn = RADIUS * theta / LENGTH
    return RADIUS * (_force(P1, EPS0 + turn) - 0.9 * _force(P2, EPS0 - turn))


def _stiffness(theta, P1, P2, h=1e-5):
    return (_torque(theta - h, P1, P2) - _torque(theta + h, P1, P2)) / (2 * h)


@pytest.fixture(scope="module")
def rests():
    """Angles as read, pressures and the torque of a weight."""
    rng, rows = np.random.default_rng(0), []
    for mean in (2.0, 2.75, 3.5):
        for difference in np.linspace(-0.8, 0.8, 7):
            for W in (0.0, 2.0, -2.0):
                P1, P2 = (mean + difference) * BAR, (mean - difference) * BAR

                def lacking(theta, P1=P1, P2=P2, W=W):
                    return _torque(theta, P1, P2) - W - 1.5 * np.sin(theta - 0.3)

                rows.append((brentq(lacking, -1.4, 1.4) + ZERO + rng.normal(0, 0.03 * DEG), P1, P2, W))
    return np.array(rows).T


def _fit(rests, **more):
    theta, P1, P2, torque = rests
    settings = {"torque": torque, "geometry": Pulley(LENGTH, RADIUS, EPS0), "model": "AffinePolynomial"}
    return fit_joint(theta, P1, P2, **settings | {"choices": False, "leave_one_out": False} | more)


def _errors(fit, rests, gravity=0.0):
    theta, P1, P2, _ = rests
    true = theta - ZERO
    return np.asarray(fit.joint.stiffness(true, P1, P2)) / (_stiffness(true, P1, P2) + gravity * np.cos(true - 0.3)) - 1


def test_muscles_are_found_without_the_known_gravity(rests):
    fit = _fit(rests, gravity=HANGING)
    assert np.abs(_errors(fit, rests)).max() < 0.02
    assert abs(fit.zero - ZERO) < 4 * fit.standard_deviations["zero"]
    assert fit.rms < 0.05 * DEG


def test_without_it_they_contain_it(rests):
    fit = _fit(rests)
    assert np.abs(_errors(fit, rests, 1.5)).max() < 0.1
    assert np.abs(_errors(fit, rests)).min() > 0.05


def test_known_gravity_acts_as_a_known_weight(rests):
    still = rests[:, rests[3] == 0]
    assert _fit(still).scale is None
    fit = _fit(still, gravity=HANGING)
    assert np.abs(_errors(fit, still)).max() < max(0.05, 3 * fit.scale_std)


def test_a_fitted_gravity_has_an_interval_and_says_what_it_does_not_tell(rests):
    fit = _fit(rests, gravity=None)
    std, _ = fit.gravity_std
    assert abs(fit.gravity.torque - 1.5) < 4 * std
    assert any("is not told from the muscles" in warning for warning in fit.warnings) == (std > 0.05 * 1.5)


def test_gravity_is_not_fitted_without_a_weight(rests):
    with pytest.raises(InvalidInput, match="hang a known weight"):
        _fit(rests[:, rests[3] == 0], gravity=None)


def test_a_known_zero_is_held_and_a_doubtful_one_reported(rests):
    fit = _fit(rests, gravity=HANGING, zero=ZERO)
    assert fit.zero == ZERO
    assert "zero" not in fit.standard_deviations
    assert np.abs(_errors(fit, rests)).max() < 0.02
    P = np.array([2.5, 3.0]) * BAR
    theta = fit.predict(P, P[::-1], torque=1.0).theta
    for angle, P1, P2 in zip(theta, P, P[::-1], strict=True):
        assert _torque(angle - ZERO, P1, P2) - 1.0 - 1.5 * np.sin(angle - ZERO - 0.3) == pytest.approx(0, abs=0.02)
    assert any("hold it by --zero" in warning for warning in _fit(rests, gravity=HANGING).warnings)


def test_a_zero_far_from_0_is_no_angle_out_of_reach(rests):
    theta, *others = rests
    fit = _fit(np.array([theta + 3.0, *others]), gravity=HANGING, zero=3.0 + ZERO)
    assert np.abs(_errors(fit, rests)).max() < 0.02


def test_a_joint_that_no_command_could_read_is_not_written(rests, tmp_path, monkeypatch):
    fit, path = _fit(rests, gravity=HANGING), tmp_path / "joint.toml"
    monkeypatch.setattr(storage, "_MOST", 1.0)  # N
    with pytest.raises(InvalidInput, match=r"N at 5 bar and rest length.* nothing was written"):
        fit.save(path)
    assert not path.exists()


def test_the_file_keeps_what_is_said_of_the_joint(rests, tmp_path):
    fit, path = _fit(rests, gravity=HANGING), tmp_path / "joint.toml"
    fit.save(path)
    assert "limits are those of the rests" in path.read_text()
    assert Gravity.of_file(Table.read(path)) == HANGING
    own = path.read_text().replace("[plant]", "[plant]\nslew = 800000.0\nlag = [0.1, 0.2]")
    own = own.replace("[source]", "[gas]\nkappa = 1.2\n\n[source]")
    path.write_text(own)
    joint, again = load_joint(path), tmp_path / "again.toml"
    fit.save(again, said=Said.of(Table.read(path), stops=(-1.0, 1.0)))
    written = Table.read(again).entries
    assert written["plant"] == {"slew": 8e5, "lag": [0.1, 0.2], "gravity_torque": 1.5, "hanging_angle": 0.3}
    assert "limits" not in written["source"]
    kept = load_joint(again)
    assert (kept.angle_limits, kept.gas.kappa) == ((-1.0, 1.0), 1.2)
    assert kept.pressure_limits == joint.pressure_limits
