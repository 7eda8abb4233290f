"""Ctrl-C inside CasADi reaches the caller, whatever CasADi makes of it; other errors stay what they are."""

import pytest

from mpc.yardsticks.shooting import interruptible


def test_a_conversion_that_returns_with_the_interrupt_set_is_an_interrupt():
    with pytest.raises(KeyboardInterrupt), interruptible():
        raise SystemError("returned a result with an exception set") from KeyboardInterrupt()


def test_a_callback_whose_error_names_the_interrupt_is_an_interrupt():
    with pytest.raises(KeyboardInterrupt), interruptible():
        raise RuntimeError("Error in Function::call: KeyboardInterruptException")


@pytest.mark.parametrize(
    "error", [SystemError("error return without exception set"), RuntimeError("singular"), ValueError()]
)
def test_other_errors_go_through(error):
    with pytest.raises(type(error)) as caught, interruptible():
        raise error
    assert caught.value is error
