"""Counting worn lobes: counters, what they know and do not know, evaluation grouped by assembly.

===========================  ====================================================================
name                         job
===========================  ====================================================================
``make_lobe_counter``        counter of worn lobes of a chosen kind, ready to fit to windows
``make_entropy_counter``     the papers' best feature in the same place, for comparison
``LobeCounter``              count and positions together, from a probability per lobe
``EntropyLadder``            one number per window, thresholds between counts: the papers' way
``OrdinalCounter``           cumulative logit: ordinal regression on features
``GroupCalibratedCounter``   a counter whose probabilities are corrected on held-out assemblies
``ConformalCounter``         sets of counts at a chosen coverage, and refusals
``TrainingDomain``           whether windows are like those trained on
``predict_recordings``       one count from the windows of each recording
``evaluate``                 test with whole assemblies, or whole conditions, held out
``learning_curve``           the same against the number of training assemblies
``noise_sweep``              the same against noise
``LobeLocator``              probability per lobe of being worn
``LobeModel``                counter and locator for whole recordings, with what they were made for
``plan_recording``           how long to record to tell n worn lobes from n + 1
``evaluate_load_levels``     the toolkit's features on measured gearbox vibration
===========================  ====================================================================
"""

from cyclofeat.counting._calibration import GroupCalibratedCounter
from cyclofeat.counting._combine import RecordingCounts, predict_recordings
from cyclofeat.counting._conformal import ConformalCounter, CountSet
from cyclofeat.counting._domain import TrainingDomain
from cyclofeat.counting._evaluation import evaluate, learning_curve, noise_sweep
from cyclofeat.counting._evaluation_summary import Evaluation, score_text
from cyclofeat.counting._ladder import EntropyLadder
from cyclofeat.counting._load_levels import LoadLevelResult, evaluate_load_levels
from cyclofeat.counting._lobes import LobeCounter
from cyclofeat.counting._locator import LobeLocator, passage_of_lobe_zero
from cyclofeat.counting._model import LobeCount, LobeModel
from cyclofeat.counting._ordinal import OrdinalCounter
from cyclofeat.counting._pipelines import make_entropy_counter, make_lobe_counter
from cyclofeat.counting._plan import RecordingPlan, plan_recording

__all__ = [
    "ConformalCounter",
    "CountSet",
    "EntropyLadder",
    "Evaluation",
    "GroupCalibratedCounter",
    "LoadLevelResult",
    "LobeCount",
    "LobeCounter",
    "LobeLocator",
    "LobeModel",
    "OrdinalCounter",
    "RecordingCounts",
    "RecordingPlan",
    "TrainingDomain",
    "evaluate",
    "evaluate_load_levels",
    "learning_curve",
    "make_entropy_counter",
    "make_lobe_counter",
    "noise_sweep",
    "passage_of_lobe_zero",
    "plan_recording",
    "predict_recordings",
    "score_text",
]
