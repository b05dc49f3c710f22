"""Campaigns: thousands of simulated assemblies, from a declared design to recordings on disk.

===========  ==================================================================================
module       responsibility
===========  ==================================================================================
``_design``  the design: rig, classes, repeats, explored parameters; values and runs
``_folder``  the folder: workers (joblib or dask.distributed), shards, their rows, the manifest
===========  ==================================================================================
"""

from cyclofeat.simulators.campaign._design import Campaign as Campaign
from cyclofeat.simulators.campaign._folder import CampaignData as CampaignData
from cyclofeat.simulators.campaign._folder import WorkerLost as WorkerLost
from cyclofeat.simulators.campaign._folder import load_campaign as load_campaign
from cyclofeat.simulators.campaign._folder import made_with as made_with
from cyclofeat.simulators.campaign._folder import run_campaign as run_campaign
