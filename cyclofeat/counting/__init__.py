"""Counters of worn lobes, their calibration and refusals, and evaluation grouped by assembly.

===========================  ====================================================================
name                         job
===========================  ====================================================================
``make_lobe_counter``        counter of worn lobes of a chosen kind, ready to fit to windows
``LobeCounter``              count and positions, by trees or by a network
``EntropyLadder``            one number per window, thresholds between counts: the papers' way
``GroupCalibratedCounter``   a counter whose probabilities are corrected on held-out assemblies
``TrainingDomain``           test of whether windows resemble those of training
``evaluate``                 test with whole assemblies, or whole conditions, held out
``rank_features``            table of features by how they depend on the count
``LobeModel``                estimator that counts and locates the worn lobes of recordings
``LobeStream``               the same for samples that arrive in pieces
``counts_frame``             answers for many recordings as a data frame
``plan_measurement``         length of a recording that tells n worn lobes from n + 1; least wear that shows
``Protocol``                 choice of what is held out, and of how intervals are computed
===========================  ====================================================================

The default model of ``cyclofeat train`` is a ``LobeModel``: a ``LobeCounter`` counts and locates by
trees, and ``TrainingDomain`` and the speed check refuse.
"""

from cyclofeat.counting.calibration.group_calibrated_counter import GroupCalibratedCounter
from cyclofeat.counting.calibration.training_domain import TrainingDomain
from cyclofeat.counting.estimators.entropy_ladder import EntropyLadder
from cyclofeat.counting.estimators.lobe_counter import LobeCounter
from cyclofeat.counting.estimators.lobe_positions import passage_of_lobe_zero
from cyclofeat.counting.estimators.pipelines import make_lobe_counter
from cyclofeat.counting.evaluation.evaluate import Protocol, evaluate
from cyclofeat.counting.evaluation.evaluation import Evaluation
from cyclofeat.counting.evaluation.rank_features import rank_features
from cyclofeat.counting.model._training import samples_per_turn_at as samples_per_turn_at
from cyclofeat.counting.model.lobe_count import LobeCount, counts_frame
from cyclofeat.counting.model.lobe_model import LobeModel
from cyclofeat.counting.model.lobe_stream import LobeStream
from cyclofeat.counting.planning import MeasurementPlan, plan_measurement

__all__ = [
    "EntropyLadder",
    "Evaluation",
    "GroupCalibratedCounter",
    "LobeCount",
    "LobeCounter",
    "LobeModel",
    "LobeStream",
    "MeasurementPlan",
    "Protocol",
    "TrainingDomain",
    "counts_frame",
    "evaluate",
    "make_lobe_counter",
    "passage_of_lobe_zero",
    "plan_measurement",
    "rank_features",
]
