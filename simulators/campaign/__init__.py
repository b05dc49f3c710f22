"""Campaigns: thousands of simulated assemblies, from a declared design to recordings on disk.

===========  ==================================================================================
module       responsibility
===========  ==================================================================================
``_design``  the design: rig, classes, repeats, explored parameters; the values of each run
``_run``     runs on the cores of one machine (joblib) or of many (dask.distributed)
``_folder``  the folder: shards, their rows, the manifest; a finished campaign, memory-mapped
===========  ==================================================================================
"""

from cyclofeat.simulators.campaign._design import Campaign as Campaign
from cyclofeat.simulators.campaign._folder import CampaignData as CampaignData
from cyclofeat.simulators.campaign._folder import load_campaign as load_campaign
from cyclofeat.simulators.campaign._folder import run_campaign as run_campaign
from cyclofeat.simulators.campaign._run import WorkerLost as WorkerLost
from cyclofeat.simulators.campaign._run import made_with as made_with
