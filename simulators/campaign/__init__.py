"""Campaigns: thousands of simulated assemblies, from a declared design to recordings on disk.

============  ==================================================================================
module        responsibility
============  ==================================================================================
``_design``   the design: rig, classes, repeats, explored parameters; the values of each run
``_run``      one run: torque and a row of labels and true values
``_workers``  runs on the cores of one machine (joblib) or of many (dask.distributed)
``_store``    the folder: shards, their rows, the manifest
``_load``     a finished campaign, memory-mapped
``_campaign`` workers simulate, this process writes
============  ==================================================================================
"""

from cyclofeat.simulators.campaign._campaign import run_campaign
from cyclofeat.simulators.campaign._design import Campaign
from cyclofeat.simulators.campaign._load import CampaignData, Shards, load_campaign
from cyclofeat.simulators.campaign._run import made_with
from cyclofeat.simulators.campaign._workers import WorkerLost

__all__ = [
    "Campaign",
    "CampaignData",
    "Shards",
    "WorkerLost",
    "load_campaign",
    "made_with",
    "run_campaign",
]
