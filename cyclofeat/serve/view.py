"""Words and tables for what the commands printed."""

from __future__ import annotations

import os
import re
import shlex
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cyclofeat._base.progress import seconds_text
from cyclofeat._base.quantities import QUANTITIES, in_words, number_of
from cyclofeat.counting.evaluation.evaluation import score_text
from cyclofeat.datasets.readers import MANIFEST
from cyclofeat.models import ModelFileError
from cyclofeat.models.card import read_card
from cyclofeat.report import template_environment
from cyclofeat.serve.jobs import Job, Session

# The look is that of the reports.
TEMPLATES = template_environment("cyclofeat.serve")


def render_parts(session: Session) -> dict[str, Any]:
    """Return what changes on the page: HTML by the id of its element, and what the script needs to know."""
    # A command may still be writing a recording. Of each file, what was last found in it.
    present = [name for name in session.store.items if (session.store.recordings / name).exists()]
    inspections = [job for job in session.jobs.values() if job.command == "inspect"]
    facts = {row["file"]: row for job in inspections for row in job.result if "file" in row}
    recordings: list[dict[str, Any]] = [
        {
            "name": name,
            "folder": session.store.items[name],
            "stated": session.store.stated.get(name, {}),
            "files": [_describe_file(row) for file, row in facts.items() if Path(file).parts[0] == name],
        }
        for name in present
    ]
    jobs = [_describe_job(job) for job in reversed(session.jobs.values()) if job.command != "inspect"]
    channels = {name: unit for row in facts.values() for name, unit in (row.get("channels") or {}).items()}
    html = {
        "model": {"model": _describe_model(session)},
        "channel": {"channels": channels},
        "simulated": {"names": present},
        "gap_files": {"files": [path.name for kind, path in session.store.others.items() if kind != "model"]},
        "recordings": {"recordings": recordings, "quantities": {name: in_words(name) for name in QUANTITIES}},
        "jobs": {"jobs": jobs},
    }
    rendered = {name: TEMPLATES.get_template(f"{name}.html").render(values) for name, values in html.items()}
    rendered["time_channel"] = rendered["angle_channel"] = rendered["channel"]
    return {
        "html": rendered,
        "status": _status_text(session, recordings),
        "busy": bool(session.running_jobs),
        "uninspected": [row["name"] for row in recordings if not row["files"]],
    }


def _describe_model(session: Session) -> dict[str, str] | None:
    """Describe the model by its card; None for the packaged ones."""
    path = session.store.others.get("model") or (Path(session.given[1]) if session.given else None)
    if path is None:
        return None
    try:
        card = read_card(path)
    except (ModelFileError, OSError) as error:
        return {"name": path.name, "text": "", "error": str(error)}
    scores, rate, speed = card["scores"], card["sampling_rate"], card["input_speed_hz"]
    trained = card["training"].get("speeds_rpm")
    at = [f"{rate:g} Hz"] if rate else []  # of windows over time alone
    if speed:
        at.append(f"{60 * speed:g} RPM")
    elif trained:
        at.append(f"{' to '.join(dict.fromkeys(f'{rpm:.4g}' for rpm in trained))} RPM")
    text = f"counts {min(card['classes'])} to {max(card['classes'])} worn lobes"
    if at:
        text += f" in recordings at {' and '.join(at)}"
    if scores and "accuracy_interval" in scores:  # one may save any scores with a model
        text += f"; {score_text(scores)}, on assemblies held out"
    return {"name": path.name, "text": text, "error": ""}


def _describe_file(row: Mapping[str, Any]) -> dict[str, Any]:
    described = {"name": row["file"], "error": row.get("error", ""), "channels": row.get("channels") or {}}
    if described["error"]:
        return described
    turns = row["output_turns"]
    cells = [
        f"{row['channel']} ({row['unit']})",
        f"{row['sampling_rate']:g} Hz",
        f"{row['duration_s']:.4g} s" + ("" if turns is None else f", {turns:.3g} output turns"),
        *(
            "not known" if speed is None else f"{speed:.5g} RPM"
            for speed in (row["speed_rpm"], row["speed_measured_rpm"])
        ),
    ]
    speed = row["speed_rpm"] or row["speed_measured_rpm"]
    return described | {"cells": cells, "warnings": row["warnings"], "speed": speed}


def _describe_job(job: Job) -> dict[str, Any]:
    """Describe a job and what came out of it."""
    command_line = shlex.join(["cyclofeat", job.command, *job.arguments])
    # A terminal needs the manifest, too, that the page has written.
    rows = [f"{MANIFEST}: {', '.join((name, *row.values()))}" for name, row in job.rows.items()]
    counted = re.search(r"(\d+) of (\d+)", job.message)
    return {
        "job": job,
        "progress": counted.groups() if counted else None,
        "elapsed": seconds_text(time.monotonic() - job.began),
        "estimate": next((text for text in job.messages if " takes about " in text), ""),
        "messages": [
            text.replace(f"{job.folder}{os.sep}", "") for text in (command_line, *rows, *job.messages)
        ],
        "counts": _describe_counts(job),
        "gap": job.result[0]["text"] if job.command == "gap" and job.state == "done" else [],
    }


def _describe_counts(job: Job) -> list[dict[str, Any]]:
    """Describe the answers of ``count``; none of other commands."""
    rows = [{"error": "", **row} for row in job.result if "file" in row and job.command == "count"]
    for row in rows:
        if row["error"]:
            continue
        count = row["refused_defect_count"] if row["refused"] else row["defect_count"]
        row["count"] = number_of(count, "worn lobe") if count else "no worn lobe"
        row["probability"] = f"{row['probability'][str(count)]:.2f}"
        row["positions"] = "" if row["refused"] else ", ".join(map(str, row["worn_lobes_from_1"]))
        if row["positions"] and not row["lobes_absolute"]:
            row["positions"] += " (relative)"
    return rows


def _status_text(session: Session, recordings: list[dict[str, Any]]) -> str:
    """Say what happens or has happened, and what to do next."""
    running = session.running_jobs
    if running:
        job = running[-1]
        return f"{job.title}: {job.message}."
    jobs = list(session.jobs.values())
    ended = ""
    if jobs:
        job = jobs[-1]
        rows = _describe_counts(job)
        counts = [
            f"{row['file']}: {'refused' if row['refused'] else row['count']}"
            for row in rows
            if not row["error"]
        ]
        ended = f"{counts[0] if counts else f'{job.title}: done'}. "
        if job.state != "done":
            error = (job.error or job.state).rstrip(".")
            ended = f"{'' if error.startswith(job.recordings) else f'{job.title}: '}{error}. "
        elif len(rows) > 1:
            ended = f"{len(counts)} of {number_of(len(rows), 'recording')} counted. "
    files = [file for recording in recordings for file in recording["files"]]
    wrong = [file["name"] for file in files if file["error"]]
    if not recordings:
        following = "choose recordings, or simulate an example."
    elif jobs and jobs[-1].state == "done" and jobs[-1].outputs:
        following = "open the page of the result, or choose other recordings."
    elif wrong:
        following = f"state what {wrong[0]} lacks, below it or in step 3, or remove it."
    elif not all(file["speed"] for file in files):
        following = "state the speed of the input shaft (step 3), then press Count worn lobes."
    else:
        following = "check what was found in the recordings, then press Count worn lobes."
    return f"{ended}Next: {following}"
