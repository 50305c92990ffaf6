"""What a report on one run begins with: pictures and a replay of the robot, and three numbers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ogmp_sb3.config import registry
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.evaluation.evaluate import RETURN, TRUE_OBJECTIVE, Evaluation
from ogmp_sb3.evaluation.evaluated_policy import EvaluatedPolicy
from ogmp_sb3.evaluation.metrics import SURVIVED, highest_return
from ogmp_sb3.evaluation.recording import RECORDED, record_chosen
from ogmp_sb3.evaluation.statistics import Estimate, as_text, estimate
from ogmp_sb3.rendering.opengl import gl_library
from ogmp_sb3.rendering.player import Player
from ogmp_sb3.rendering.video import picture_count, write_video
from ogmp_sb3.report.page import (
    Inset,
    KeyNumber,
    KeyNumbers,
    Note,
    Part,
    Picture,
    Section,
    Video,
    data_uri,
    first_paragraph,
)
from ogmp_sb3.report.replay import write_replay
from ogmp_sb3.report.run_sections import THIN
from ogmp_sb3.runs.callbacks import progress_bar, steps_bar

FILM_TIME = 6.0  # s of an episode at most
STRIP, VIDEO, REPLAY = "film.png", "film.mp4", "replay"


def headline(subject: EvaluatedPolicy, result: Evaluation, shown: list[Part]) -> Section:
    """The three numbers that say most, below the first picture.

    :param shown: pictures, videos, a replay
    """
    numbers = [_objective(subject.task, result), _survival(result), _return(subject.task, result)]
    return Section("", "", [*shown[:1], KeyNumbers(numbers), *shown[1:]])


def replay_of(subject: EvaluatedPolicy, episodes: int, seed: int, out: Path) -> Inset:
    """A replay of chosen test episodes, also as a page of its own, ``replay.html``.

    :param episodes: how many they are chosen from
    :param seed: of the first
    :param out: directory of the page
    """
    task = subject.task.for_evaluation()
    with steps_bar((episodes + RECORDED) * task.episode_steps, "replay") as bar:
        chosen = record_chosen(subject.loaded, task, episodes, seed, bar.update)
        bar.update(bar.total - bar.n)  # fewer may have been chosen
    page = out / f"{REPLAY}.html"
    subtitle = f"{len(chosen)} of {episodes} test episodes, chosen by return"
    write_replay(page, subject.task, chosen, subject.task.name, subtitle)
    caption = f"Replay of {subtitle}: turn, zoom, and drag the time."
    return Inset(REPLAY, caption, page.read_text(encoding="utf-8"))


def film_of(subject: EvaluatedPolicy, seed: int, kinds: Sequence[str], out: Path) -> list[Part]:
    """The first seconds of an episode as a strip of pictures, as a video, or both; or why there is none.

    :param seed: of the episode
    :param kinds: which of :data:`STRIP` and :data:`VIDEO`
    :param out: directory of the page
    :raises ValueError: if a video is wanted, and nothing can be drawn here
    """
    if not kinds:
        return []
    try:
        gl_library()
    except ValueError as error:
        if VIDEO in kinds:
            raise
        return [Note(f"No pictures of the robot: {error}")]
    player = Player(subject.task, subject.loaded.policy, seed)
    frames = [player.frame]
    while not frames[-1].ended and frames[-1].time < FILM_TIME:
        frames.append(player.step())
    with progress_bar(sum(picture_count(len(frames), out / kind) for kind in kinds), "picture") as bar:
        for kind in kinds:
            write_video(frames, subject.task, out / kind, bar.update)
    about = f"The episode of seed {seed}, its first {frames[-1].time:.1f} s; in blue what the oracle plans."
    parts: list[Part] = []
    if STRIP in kinds:
        parts.append(Picture(STRIP.removesuffix(".png"), about, data_uri(out / STRIP, "image/png"), [STRIP]))
    if VIDEO in kinds:
        parts.append(Video(about, data_uri(out / VIDEO, "video/mp4")))
    return parts


def _objective(task: TaskConfig, result: Evaluation) -> KeyNumber:
    found = result.metrics[TRUE_OBJECTIVE]
    yes_or_no = all(isinstance(value, bool) for value in result.values.get(TRUE_OBJECTIVE, [0.0]))
    about = first_paragraph(registry.objectives.get(task.objective))
    return _number(
        task.objective.replace("_", " "), found, 100.0 if yes_or_no else 1.0, "%" if yes_or_no else "", about
    )


def _survival(result: Evaluation) -> KeyNumber:
    counts = result.terminations.items()
    survived = estimate([cause in SURVIVED for cause, count in counts for _ in range(count)])
    return _number("without a fall", survived, 100.0, "%", "Episodes that nothing ended before their time.")


def _return(task: TaskConfig, result: Evaluation) -> KeyNumber:
    highest = highest_return(task)
    limit = "" if highest is None else f", of {highest:g} at most"
    return _number("return", result.metrics[RETURN], 1.0, "", f"Sum of the training reward{limit}.")


def _number(label: str, found: Estimate, scale: float, unit: str, about: str) -> KeyNumber:
    low, high = (None if end is None else scale * end for end in (found.low, found.high))
    mean = scale * found.mean
    digits = 1 if scale != 1.0 or abs(mean) >= 10.0 else 2
    between = f"95 % interval {as_text([low, high], digits, f'{THIN}…{THIN}')}" if low is not None else "No interval"
    value = f"{mean:.{digits}f}{THIN}{unit}".rstrip()
    return KeyNumber(value, label, f"{between}, n = {found.n}. {about}")
