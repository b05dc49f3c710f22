"""Running a campaign: workers simulate, this process writes."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cyclofeat._base.checks import n_jobs as check_n_jobs
from cyclofeat.simulators.campaign._design import Campaign
from cyclofeat.simulators.campaign._load import CampaignData, load_campaign
from cyclofeat.simulators.campaign._store import complete
from cyclofeat.simulators.campaign._workers import results


def run_campaign(
    campaign: Campaign,
    out: str | os.PathLike[str],
    *,
    n_jobs: int = 1,
    scheduler: Any = None,
    progress: Callable[[int, int], object] | None = None,
) -> CampaignData:
    """Simulate the runs that are missing in a folder, until the campaign is whole.

    Parameters
    ----------
    campaign : Campaign
        The design.
    out : path
        Folder, created if necessary. A part of this campaign in it is completed.
    n_jobs : int, default 1
        Number of processes; -1 for all processors. ``joblib.parallel_config`` sets another backend.
    scheduler : str or distributed.Client, optional
        Dask scheduler or its address (``"tcp://host:8786"``) instead of ``n_jobs``. Only this process writes
        to ``out``.
    progress : callable, optional
        Called for each run that is made, in their order, with the number of finished runs and their total.

    Returns
    -------
    CampaignData
        As :func:`load_campaign` returns it. The same bytes on disk for any number and kind of workers,
        interrupted or not, with the same versions of all packages on processors of one kind.

    Raises
    ------
    ValueError
        If the folder holds another design, a campaign of other versions or other files, or if the medians of
        the design cannot be simulated.
    OSError
        If the folder cannot be written or the disk is too small. Finished shards are kept.
    WorkerLost
        If workers or the scheduler are lost. Finished shards are kept.
    RuntimeError
        If the design's kernel is "batch" or "auto" and batches cannot be compiled here.
    ImportError
        If pyarrow, or for a scheduler dask.distributed, is not installed.

    Notes
    -----
    A run that diverges, locks or whose parameters contradict each other is a row of NaN torque with
    ``status`` and ``reason``.

    Examples
    --------
    >>> import tempfile
    >>> campaign = Campaign(rig="R0", defect_counts=(0, 2), repeats=1, duration=0.1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     data = run_campaign(campaign, folder)
    ...     print(data.X.shape, data.X.dtype, data.y, data.ok)
    (2, 2560) float32 [0 2] [ True  True]
    """
    check_n_jobs(n_jobs)
    # In the folder every value is explicit: its files must not follow from the version that reads it.
    campaign = campaign.replace(runs_per_shard=campaign.shard_length)
    complete(campaign, Path(out), lambda plans: results(campaign, plans, n_jobs, scheduler), progress)
    return load_campaign(out)
