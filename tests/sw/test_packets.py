"""Packets: they are short, and give back the words that were packed."""

import dataclasses
import random

import numpy as np
import pytest

from ukf_sw.engine.control_word import READ, WRITE, Half
from ukf_sw.engine.microcode import Microcode
from ukf_sw.engine.packets import COUNT_WIDTH, DISTANCE_WIDTH, Packet, pack
from ukf_sw.spec.parameters import Form, Noise, Pipeline, UkfParams
from ukf_sw.spec.sequence import Program, Routine

HALF = Half(
    name="test", fields=("flag", "address", "begin"), counting=("address",), once=("begin",)
)


def unpack(packets, half):
    """Words of packets, written from the definition."""
    words = []
    for packet in packets:
        words.append(list(packet.word))
        for _ in range(packet.repetitions):
            word = dict(zip(half.fields, words[-packet.distance], strict=True))
            for name, step in zip(half.counting, packet.steps, strict=True):
                word[name] += step
            for name in half.once:
                word[name] = 0
            words.append(list(word.values()))
    return words


def split(number, fmt):
    """Packet of an encoded one."""

    def field(at):
        return number >> at.lsb & (1 << at.width) - 1

    assert number < 1 << fmt.width
    return Packet(
        word=tuple(field(at) for at in fmt.fields),
        repetitions=field(fmt.count),
        distance=field(fmt.distance) + 1,
        steps=tuple(field(fmt.steps) >> k & 1 for k in range(fmt.steps.width)),
    )


def test_a_run_that_counts_is_one_packet():
    words = np.array([[1, 7 + k, k == 0] for k in range(20)], dtype=np.int32)
    (packet,) = pack(words, HALF)
    assert packet == ((1, 7, 1), 19, 1, (1,))


def test_interleaved_runs_share_a_packet():
    rows = [[[1, 10 + k, 0], [0, 50 + k, 0], [1, 90 + k, 0]] for k in range(9)]
    words = np.array(rows, dtype=np.int32).reshape(-1, 3)
    packets = list(pack(words, HALF))
    assert len(packets) == 3
    assert packets[-1][1:] == (24, 3, (1,))


def test_a_repetition_does_not_begin_again():
    words = np.array([[1, 4, 1]] * 6, dtype=np.int32)
    assert len(list(pack(words, HALF))) == 6


@pytest.mark.parametrize("seed", range(20))
def test_random_words_come_back(seed):
    rng = np.random.default_rng(seed)
    words = rng.integers(0, (2, 3, 2), size=(rng.integers(1, 400), 3), dtype=np.int32)
    packets = list(pack(words, HALF))
    assert unpack(packets, HALF) == words.tolist()
    assert all(packet.repetitions < 1 << COUNT_WIDTH for packet in packets)
    assert all(1 <= packet.distance <= 1 << DISTANCE_WIDTH for packet in packets)


@pytest.mark.parametrize("seed", range(8))
def test_programs_come_back(seed):
    rng = random.Random(seed)
    noise = [rng.choice(list(Noise)) for _ in range(2)]
    n, m = rng.randint(1, 9), rng.randint(1, 6)
    params = UkfParams(
        n=n, m=m, q=rng.choice([0, n]), r=m, form=rng.choice(list(Form)),
        process_noise=noise[0], observation_noise=noise[1],
    )  # fmt: skip
    params = dataclasses.replace(params, pes=rng.randint(1, params.columns))
    pipeline = Pipeline(multiply=rng.randint(1, 4), add=rng.randint(1, 4))
    code = Microcode(params, pipeline)
    assert list(code.streams) == [READ, WRITE]
    assert code.format.present(READ.fields + WRITE.fields) == tuple(code.format.fields)
    for half, stream in code.streams.items():
        columns = code.format.decode(code.words)
        expected = np.stack(
            [columns[field.name] for field in stream.format.fields], axis=1
        ).tolist()
        starts = [stream.entry[program] for program in code.programs]
        ends = [*starts[1:], len(stream.packets)]
        present = half._replace(fields=code.format.present(half.fields))
        found = []
        for start, end in zip(starts, ends, strict=True):
            # By itself: a program repeats no word of another, which may not have been executed.
            found += unpack(
                [split(number, stream.format) for number in stream.packets[start:end]], present
            )
        assert found == expected


def test_packets_are_fewer_than_words():
    """What they are for: half of the memory or less with few processing elements."""
    code = Microcode(UkfParams(n=7, m=6, q=7, r=6), Pipeline())
    bits = sum(len(s.packets) * s.format.width for s in code.streams.values())
    assert bits < len(code.words) * code.format.width / 3
    assert code.streams[READ].entry[Routine(Program.INIT)] == 0
