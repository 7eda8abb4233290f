"""Words among arguments: whatever is given in their place is refused in one sentence."""

import numpy as np
import pytest

from allocator import allocate
from allocator.errors import AntagonistError
from allocator.mechanism.machines import arm26

NO_WORDS = (
    np.array(["torque"]), np.array([1.0, 2.0]), np.array([True, False]), np.array([]), np.array("exact"), [], ["exact"],
    {}, 3, 1.5, b"exact", None, object(), np.zeros((40, 40)),
)  # fmt: skip


def on_a_joint(**argument):
    return allocate(0.1, 7.5, 0.5, **argument)


def on_a_mechanism(**argument):
    return allocate([0.3, 0.4], 5 * np.eye(2), joint=arm26(), **argument)


@pytest.mark.parametrize(
    ("ask", "name"),
    [
        (on_a_joint, "method"), (on_a_joint, "priority"), (on_a_mechanism, "method"), (on_a_mechanism, "priority"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("given", NO_WORDS, ids=lambda given: type(given).__name__)
def test_what_is_no_word_is_refused(ask, name, given):
    with pytest.raises(AntagonistError, match=name):
        ask(**{name: given})


@pytest.mark.parametrize("ask", [on_a_joint, on_a_mechanism])
@pytest.mark.parametrize("given", [given for given in NO_WORDS if given is not None])
def test_what_is_no_axis_is_refused(ask, given):
    with pytest.raises(AntagonistError, match="along = "):
        ask(along=given)


@pytest.mark.parametrize("given", [given for given in NO_WORDS if given is not None])
def test_what_is_no_joint_is_refused(given):
    with pytest.raises(AntagonistError, match="joint = "):
        on_a_joint(joint=given)


def test_words_of_numpy_are_words():
    asked = on_a_joint(method=np.str_("exact"), priority=np.str_("torque"))
    assert asked.P1 == pytest.approx(on_a_joint().P1, rel=1e-9)
    many = on_a_mechanism(method=np.str_("exact"), priority=np.str_("torque"))
    np.testing.assert_allclose(many.P, on_a_mechanism().P)
