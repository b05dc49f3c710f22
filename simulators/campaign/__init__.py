"""Campaigns: thousands of simulated assemblies, from a declared design to recordings on disk."""

from cyclofeat.simulators.campaign._design import Campaign as Campaign
from cyclofeat.simulators.campaign._folder import CampaignData as CampaignData
from cyclofeat.simulators.campaign._folder import WorkerLost as WorkerLost
from cyclofeat.simulators.campaign._folder import load_campaign as load_campaign
from cyclofeat.simulators.campaign._folder import made_with as made_with
from cyclofeat.simulators.campaign._folder import run_campaign as run_campaign
