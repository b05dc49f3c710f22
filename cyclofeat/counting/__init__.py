"""Counters of worn lobes, their calibration and refusals, and evaluation grouped by assembly.

===========================  ====================================================================
name                         job
===========================  ====================================================================
``make_lobe_counter``        counter of worn lobes of a chosen kind, ready to fit to windows
``make_entropy_counter``     the same with the papers' best feature, for comparison
``LobeCounter``              count and positions together, from a probability per lobe
``RowCounter``               the same for rows of neighbours, from where a row begins and how long it is
``EntropyLadder``            one number per window, thresholds between counts: the papers' way
``OrdinalCounter``           cumulative logit: ordinal regression on features
``GroupCalibratedCounter``   a counter whose probabilities are corrected on held-out assemblies
``ConformalCounter``         sets of counts at a chosen coverage, and refusals
``ConformalRegressor``       a number with an interval of a chosen coverage
``TrainingDomain``           test of whether windows resemble those of training
``predict_recordings``       one count from the windows of each recording
``evaluate``                 test with whole assemblies, or whole conditions, held out
``learning_curve``           evaluation against the number of training assemblies
``noise_sweep``              evaluation against noise
``LobeLocator``              probability per lobe of being worn
``LobeModel``                counter and locator for whole recordings
``LobeStream``               the same for samples that arrive in pieces
``RecordingCounter``         estimator that trains a ``LobeModel`` in ``fit``
``REFUSED``                  what ``predict`` returns for a refused recording: -1
``RadialWear``               count and depth of radial wear from several windows in a row
``counts_frame``             answers for many recordings as a data frame
``plan_recording``           length of a recording that tells n worn lobes from n + 1
``plan_wear``                least depth of radial wear that shows
``Protocol``                 choice of what is held out, and of how intervals are computed
``train_and_test``           evaluation on other windows than those of training
``features_seen``            features that a fitted counter uses
===========================  ====================================================================

The default model of ``cyclofeat train`` is a ``LobeModel``: a ``LobeMap`` with trees
(``trees.CountingTrees``) counts, ``GroupCalibratedCounter`` calibrates, ``LobeLocator`` locates, and
``TrainingDomain`` and the speed check refuse.
"""

from cyclofeat.counting.calibration._pooling import pool_weights as pool_weights
from cyclofeat.counting.calibration.combine import RecordingCounts, predict_recordings

# Parts of counters, for benchmarks and for counters of users.
from cyclofeat.counting.calibration.combine import combine_proba as combine_proba
from cyclofeat.counting.calibration.combine import learn_dependence as learn_dependence
from cyclofeat.counting.calibration.conformal_counter import ConformalCounter, CountSet, features_seen
from cyclofeat.counting.calibration.conformal_counter import conformal_threshold as conformal_threshold
from cyclofeat.counting.calibration.conformal_regressor import ConformalRegressor
from cyclofeat.counting.calibration.group_calibrated_counter import GroupCalibratedCounter
from cyclofeat.counting.calibration.training_domain import TrainingDomain
from cyclofeat.counting.estimators.entropy_ladder import EntropyLadder
from cyclofeat.counting.estimators.lobe_counter import LobeCounter
from cyclofeat.counting.estimators.lobe_locator import LobeLocator, passage_of_lobe_zero
from cyclofeat.counting.estimators.lobe_sets import best_sets as best_sets
from cyclofeat.counting.estimators.lobe_sets import inclusion as inclusion
from cyclofeat.counting.estimators.lobe_sets import log_counts as log_counts
from cyclofeat.counting.estimators.ordinal_counter import OrdinalCounter
from cyclofeat.counting.estimators.pipelines import KINDS as KINDS
from cyclofeat.counting.estimators.pipelines import make_entropy_counter, make_lobe_counter
from cyclofeat.counting.estimators.row_counter import RowCounter
from cyclofeat.counting.evaluation.assembly_folds import grouped_folds as grouped_folds
from cyclofeat.counting.evaluation.evaluate import Protocol, evaluate
from cyclofeat.counting.evaluation.evaluation import Evaluation, score_text
from cyclofeat.counting.model._predictions import REFUSED
from cyclofeat.counting.model._speed import other_speed as other_speed
from cyclofeat.counting.model._training import samples_per_turn_at as samples_per_turn_at
from cyclofeat.counting.model.lobe_count import LobeCount, WindowCount, counts_frame
from cyclofeat.counting.model.lobe_model import LobeModel
from cyclofeat.counting.model.lobe_stream import LobeStream
from cyclofeat.counting.model.radial_wear import RadialWear, WearDepth
from cyclofeat.counting.model.radial_wear import lobe_lines_nm as lobe_lines_nm
from cyclofeat.counting.model.radial_wear import runs_of as runs_of
from cyclofeat.counting.model.radial_wear import wear_features as wear_features
from cyclofeat.counting.model.recording_counter import RecordingCounter
from cyclofeat.counting.planning.plan_recording import RecordingPlan, plan_recording
from cyclofeat.counting.planning.plan_recording import Trial as Trial
from cyclofeat.counting.planning.plan_recording import detection_table as detection_table
from cyclofeat.counting.planning.plan_wear import WearPlan, plan_wear

__all__ = [
    "REFUSED",
    "ConformalCounter",
    "ConformalRegressor",
    "CountSet",
    "EntropyLadder",
    "Evaluation",
    "GroupCalibratedCounter",
    "LobeCount",
    "LobeCounter",
    "LobeLocator",
    "LobeModel",
    "LobeStream",
    "OrdinalCounter",
    "Protocol",
    "RadialWear",
    "RecordingCounter",
    "RecordingCounts",
    "RecordingPlan",
    "RowCounter",
    "TrainingDomain",
    "WearDepth",
    "WearPlan",
    "WindowCount",
    "counts_frame",
    "evaluate",
    "features_seen",
    "make_entropy_counter",
    "make_lobe_counter",
    "passage_of_lobe_zero",
    "plan_recording",
    "plan_wear",
    "predict_recordings",
    "score_text",
]
