"""The private pieces of scikit-learn that cyclofeat uses: here and nowhere else.

They exist under these names in scikit-learn 1.6 to 1.9. When a release moves one, this is the file to mend.
"""

from sklearn import base
from sklearn.utils import _param_validation, validation

fit_context = base._fit_context
Interval = _param_validation.Interval
StrOptions = _param_validation.StrOptions
check_feature_names_in = validation._check_feature_names_in
