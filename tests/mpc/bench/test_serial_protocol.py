"""Frames come across a serial line whole, or not at all."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from allocator.errors import InvalidInput
from mpc.bench.device import SimulatedClock
from mpc.bench.devices.serial_protocol import (
    ANSWERS,
    CRC_BYTES,
    HEADER,
    JOINT,
    LAYOUTS,
    LONGEST,
    REASONS,
    SAMPLE,
    Frame,
    Kind,
    Receiver,
    Refusal,
    Sizes,
    State,
    decoded,
    encoded,
    packing,
    stuffed,
    unstuffed,
)

from ...rigs.fuzz import NoisyDevice, SlowLine

NUMBERS = {
    "u8": st.integers(0, 2**8 - 1),
    "i8": st.integers(-(2**7), 2**7 - 1),
    "u16": st.integers(0, 2**16 - 1),
    "u32": st.integers(0, 2**32 - 1),
    "f32": st.floats(width=32, allow_nan=False),
}


BOARDS = (JOINT, Sizes(2, 6), Sizes(3, 7))


def row(numbers, size):
    return st.tuples(*[numbers] * size)


@st.composite
def frames(draw, sizes=JOINT):
    kind = draw(st.sampled_from(Kind))
    values = [
        draw(row(NUMBERS[field.type], sizes.count(field.row)) if field.row else NUMBERS[field.type])
        for field in LAYOUTS[kind]
    ]
    samples = ()
    if kind is Kind.FOLLOW:
        numbers = sizes.count("n") + sizes.count("s")
        samples = draw(row(NUMBERS["f32"], numbers * draw(st.integers(0, sizes.batch))))
    return Frame(kind, draw(NUMBERS["u16"]), draw(NUMBERS["u16"]), tuple(values), samples)


@pytest.mark.parametrize(
    ("plain", "stuffed_"),
    [
        ("00", "01 01"),
        ("00 00", "01 01 01"),
        ("00 11 00", "01 02 11 01"),
        ("11 22 00 33", "03 11 22 02 33"),
        ("11 22 33 44", "05 11 22 33 44"),
        ("11 00 00 00", "02 11 01 01 01"),
    ],
)
def test_the_examples_of_cheshire_and_baker_are_stuffed_as_they_are(plain, stuffed_):
    assert stuffed(bytes.fromhex(plain)) == bytes.fromhex(stuffed_)
    assert unstuffed(bytes.fromhex(stuffed_)) == bytes.fromhex(plain)


@given(st.sampled_from(BOARDS), st.data())
def test_frames_arrive_however_they_are_cut(sizes, data):
    sent = data.draw(st.lists(frames(sizes), max_size=5))
    line = b"".join(encoded(frame, sizes) for frame in sent)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(line)), max_size=8)))
    receiver, came = Receiver(sizes), []
    for begin, end in zip([0, *cuts], [*cuts, len(line)], strict=True):
        came += receiver.frames(line[begin:end])
    assert came == sent
    assert receiver.damaged == 0


@given(frames(), st.data())
def test_a_frame_with_up_to_three_wrong_bits_is_none(sent, data):
    """A CRC-32 finds all errors of three bits in frames as short as these; those that make zeros cut them."""
    line = bytearray(encoded(sent))
    for bit in data.draw(st.sets(st.integers(0, 8 * len(line) - 1), min_size=1, max_size=3)):
        line[bit // 8] ^= 1 << bit % 8
    came = list(Receiver().frames(bytes(line) + b"\0"))
    inside = bytes(line[1:-1]) == encoded(sent)[1:-1]  # what was hit were the zeros around it
    assert came == [] or (inside and came == [sent])


@given(frames(), st.binary(max_size=2 * LONGEST))
def test_a_frame_comes_through_whatever_came_before(sent, garbage):
    assert list(Receiver().frames(garbage + encoded(sent)))[-1:] == [sent]


@given(st.binary(max_size=300))
def test_whatever_comes_decoding_does_not_raise(stretch):
    assert decoded(stretch) is None or encoded(decoded(stretch))[1:-1] == stretch


def test_readings_are_dated_as_exactly_as_the_swiftest_exchanges_allow():
    clock = SimulatedClock()
    line = SlowLine(np.random.default_rng(0), clock)
    errors = []
    with NoisyDevice(line, clock) as device:
        for k in range(3000):
            clock.sleep_until(0.01 * k)
            errors.append(device.read().t - line.measured)
    assert np.abs(errors).max() < 3e-3  # never beyond its exchange
    assert np.abs(errors[100:]).max() < 1e-4  # of exchanges that take 2.5 ms in the mean
    assert device.board_time == pytest.approx(30 * 1.0001, abs=0.02)


def test_every_frame_fits_into_one_block():
    for n in range(1, 12):
        for m in range(1, 40):
            sizes = Sizes(n, m)
            longest = {kind: packing(fields, sizes).size for kind, fields in LAYOUTS.items()}
            longest[Kind.FOLLOW] += max(1, sizes.batch) * packing(SAMPLE, sizes).size
            if max(longest.values()) + packing(HEADER).size + CRC_BYTES <= LONGEST <= 253:
                sizes.check()
            else:
                with pytest.raises(InvalidInput, match=f"n = {n} joints and m = {m} muscles"):
                    sizes.check()
    assert [sizes.batch for sizes in BOARDS] == [16, 12, 6]


def test_every_request_has_an_answer_that_names_the_state_of_the_board():
    assert set(ANSWERS) | {*ANSWERS.values(), Kind.REFUSED} == set(Kind)
    assert all(LAYOUTS[kind][-1].name == "state" for kind in {*ANSWERS.values(), Kind.REFUSED})


def test_the_document_says_what_the_table_says():
    text = (Path(__file__).parents[3] / "docs" / "serial.md").read_text(encoding="utf-8")
    plain = re.sub(r" \[[^]]*\]", "", text)  # units
    for kind, fields in LAYOUTS.items():
        if kind is Kind.TRACKING:
            shared = LAYOUTS[Kind.READING][:-1]
            assert fields[: len(shared)] == shared
            fields = fields[len(shared) :]
        body = ", ".join(f"{f.name} {f.row} × {f.type}" if f.row else f"{f.name} {f.type}" for f in fields)
        prefix = "as READING, then " * (kind is Kind.TRACKING)
        assert f"{kind.name} 0x{kind:02X} | {prefix}{body}".rstrip() in plain
    for member in (*State, *Refusal):
        assert re.search(rf"\b{member.name} {int(member)}\b", re.sub(r"\s+", " ", text))
    assert set(REASONS) == set(Refusal)
