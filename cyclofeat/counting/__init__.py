"""Counting worn lobes: ready pipelines, evaluation grouped by assembly, models for recordings.

==========================  =====================================================================
name                        job
==========================  =====================================================================
``make_lobe_counter``       pipeline from windows to the number of worn lobes
``make_entropy_counter``    the papers' best feature in the same place, for comparison
``evaluate``                cross-validation with whole assemblies held out
``LobeLocator``             probability per lobe of being worn
``LobeModel``               counter and locator for whole recordings, with what they were made for
``evaluate_load_levels``    the toolkit's features on measured gearbox vibration
==========================  =====================================================================
"""

from cyclofeat.counting._evaluation import Evaluation, evaluate, score_text
from cyclofeat.counting._load_levels import LoadLevelResult, evaluate_load_levels
from cyclofeat.counting._locator import LobeLocator, passage_of_lobe_zero
from cyclofeat.counting._model import LobeCount, LobeModel
from cyclofeat.counting._pipelines import make_entropy_counter, make_lobe_counter

__all__ = [
    "Evaluation",
    "LoadLevelResult",
    "LobeCount",
    "LobeLocator",
    "LobeModel",
    "evaluate",
    "evaluate_load_levels",
    "make_entropy_counter",
    "make_lobe_counter",
    "passage_of_lobe_zero",
    "score_text",
]
