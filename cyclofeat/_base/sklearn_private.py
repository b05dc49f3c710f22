"""The private pieces of scikit-learn that cyclofeat uses: here and nowhere else.

They exist under these names in scikit-learn 1.6 to 1.9. When a release moves one, this is the file to mend.
"""

from sklearn.base import _fit_context as fit_context
from sklearn.utils._param_validation import Interval, StrOptions
from sklearn.utils.validation import _check_feature_names_in as check_feature_names_in

__all__ = ["Interval", "StrOptions", "check_feature_names_in", "fit_context"]
