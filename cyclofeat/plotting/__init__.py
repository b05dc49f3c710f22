"""Pictures of torque, spectrum, lobe map and gap, as Display objects in scikit-learn's idiom.

=======================  ==================================================================================
class                    picture
=======================  ==================================================================================
``TorqueDisplay``        torque over time
``SpectrumDisplay``      spectrum of the torque, with lobe lines and orders of the input shaft
``OrderDisplay``         lines of the output turn, by what they belong to: lobes, input shaft, mesh
``LobeMapDisplay``       the disc with a ring of slots, one per lobe, coloured by what the torque does there
``TrainingDisplay``      how near a recording lies to the training windows of each count, feature by feature
``GapDisplay``           where recordings and simulator differ: families, spectrum, orders, phase
``GapReductionDisplay``  how far corrected simulators close that gap
=======================  ==================================================================================

A display is made by ``from_recording`` (or ``from_estimator``) and drawn by ``plot(ax=None)``, which returns
the display itself; ``ax_`` and ``figure_`` are then there to change. Those of the gap draw at once, by
``from_locator`` and ``from_report``. Matplotlib is needed for drawing only
(``pip install "cyclofeat[plot]"``). For confusion matrices take ``sklearn.metrics.ConfusionMatrixDisplay``.
"""

from cyclofeat.plotting._gap import GapDisplay
from cyclofeat.plotting._gap_reduction import GapReductionDisplay
from cyclofeat.plotting._lobe_map import LobeMapDisplay
from cyclofeat.plotting._orders import OrderDisplay
from cyclofeat.plotting._spectrum import SpectrumDisplay
from cyclofeat.plotting._torque import TorqueDisplay
from cyclofeat.plotting._training import TrainingDisplay

__all__ = [
    "GapDisplay",
    "GapReductionDisplay",
    "LobeMapDisplay",
    "OrderDisplay",
    "SpectrumDisplay",
    "TorqueDisplay",
    "TrainingDisplay",
]
