"""The logs of a training: numbers that can be read again, whatever happened while they were written."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from helpers.faults import NO_SPACE
from ogmp_sb3.runs.logs import LOG, STEP_COLUMN, CsvWriter, TensorBoardWriter, read_rows, say, transcript


def row(step: int, **more: float) -> dict[str, float]:
    return {STEP_COLUMN: step, **more}


def steps(path: Path) -> list[int]:
    return [int(found[STEP_COLUMN]) for found in read_rows(path)]


def test_rows_are_read_as_they_were_written(tmp_path: Path) -> None:
    writer = CsvWriter(tmp_path / "progress.csv")
    writer.write(row(16, a=1.5), {})
    writer.write(row(32, b=2.5), {"b": ("csv",)})
    writer.write(row(48, c=3.5), {})
    assert read_rows(tmp_path / "progress.csv") == [
        {"a": "1.5", "c": "", STEP_COLUMN: "16"},
        {"a": "", "c": "", STEP_COLUMN: "32"},
        {"a": "", "c": "3.5", STEP_COLUMN: "48"},
    ]


def test_a_row_that_was_cut_off_at_any_place_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "progress.csv"
    writer = CsvWriter(path)
    writer.write(row(16, a=1.5), {})
    before = len(path.read_bytes())
    writer.write(row(32, a=2.5), {})
    content = path.read_bytes()
    for length in range(before, len(content) - 1):
        path.write_bytes(content[:length])
        assert steps(path) == [16]
        again = CsvWriter(path, resumed_at=16)
        again.write(row(32, a=2.5), {})
        assert steps(path) == [16, 32]


def test_a_resumed_log_drops_what_is_run_again_and_an_empty_one_is_fine(tmp_path: Path) -> None:
    path = tmp_path / "progress.csv"
    CsvWriter(path)
    CsvWriter(path, resumed_at=10).write(row(16), {})
    for step in (32, 48):
        CsvWriter(path, resumed_at=step - 16).write(row(step), {})
    CsvWriter(path, resumed_at=32)
    assert steps(path) == [16, 32]


@pytest.mark.parametrize(
    "content",
    [b"\x00\x01\n", b"\xff\xfe\n", b"a,b\n1,2\n", b"time/total_timesteps\nmany\n", b"time/total_timesteps\n1,2\n"],
)
def test_a_log_that_is_none_is_a_sentence_and_is_left_as_it_is(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "progress.csv"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"progress.csv: not readable as a log of numbers") as caught:
        CsvWriter(path, resumed_at=16)
    assert "\n" not in str(caught.value)
    assert path.read_bytes() == content


def test_a_row_that_finds_no_room_comes_with_the_next_one(tmp_path: Path, monkeypatch) -> None:
    path = tmp_path / "progress.csv"
    writer = CsvWriter(path)
    writer.write(row(16, a=1), {})

    def half(self: CsvWriter, new: dict[str, float]) -> None:
        with path.open("a") as file:
            file.write("2.5,3")
        raise NO_SPACE

    with monkeypatch.context() as patch:
        patch.setattr(CsvWriter, "_append", half)
        with pytest.warns(UserWarning, match=r"progress.csv: a row could not be written \(No space left on device\)"):
            writer.write(row(32, a=2), {})
    assert steps(path) == [16]
    writer.write(row(48, a=3), {})
    assert steps(path) == [16, 32, 48]


def test_tensorboard_has_every_number_but_what_found_no_room(tmp_path: Path, monkeypatch) -> None:
    writer = TensorBoardWriter(tmp_path)

    def half(**content: object) -> None:
        writer._file.write(b"half an event")
        raise NO_SPACE

    for step in range(16, 96, 16):
        with warnings.catch_warnings(record=True) as caught, monkeypatch.context() as patch:
            warnings.simplefilter("always")
            if step == 32:
                patch.setattr(writer, "_add", half)
            writer.write({"a": float(step), "words": "no number", "b": 1}, {"b": ("tensorboard",)}, step)
        assert len(caught) == (step == 32)
    writer.close()
    again = TensorBoardWriter(tmp_path, resumed_at=64)
    again.write({"a": 640.0}, {}, 80)
    again.close()
    events = EventAccumulator(str(tmp_path))
    events.Reload()
    assert events.Tags()["scalars"] == ["a"]
    assert [(event.step, event.value) for event in events.Scalars("a")] == [(16, 16), (48, 48), (64, 64), (80, 640)]


# ---- say, transcript ----


def test_what_is_said_is_printed_and_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    say("before")
    with warnings.catch_warnings(record=True) as shown, transcript(tmp_path):
        warnings.simplefilter("always")
        say("\nresumed at step 640")
        warnings.warn("no room for a row", stacklevel=1)
        LOG.error("cannot be trained")
    say("afterwards")
    lines = (tmp_path / "train.log").read_text(encoding="utf-8").splitlines()
    assert [line.split(" ", 2)[2] for line in lines] == [
        "INFO resumed at step 640", "WARNING no room for a row", "ERROR cannot be trained",
    ]  # fmt: skip
    assert [str(warning.message) for warning in shown] == ["no room for a row"]
    assert capsys.readouterr().out == "before\n\nresumed at step 640\nafterwards\n"


def test_an_error_that_nobody_expected_is_kept_with_its_traceback_and_runs_on(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), transcript(tmp_path):
        1 / 0  # noqa: B018
    with transcript(tmp_path):
        say("again")
    text = (tmp_path / "train.log").read_text()
    assert "ZeroDivisionError: division by zero" in text and text.endswith("INFO again\n")


def test_a_training_goes_on_where_its_transcript_cannot_be_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with transcript(tmp_path / "nowhere"):
        say("on and on")
    assert capsys.readouterr() == ("on and on\n", "")
