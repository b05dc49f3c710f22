"""The private pieces of scikit-learn that cyclofeat uses: here and nowhere else.

They exist under these names in scikit-learn 1.6 to 1.9. When a release moves one, this is the file to mend.
"""

import sys
from itertools import accumulate

from sklearn.base import BaseEstimator
from sklearn.base import _fit_context as fit_context
from sklearn.utils._param_validation import Interval, StrOptions
from sklearn.utils.validation import _check_feature_names_in as check_feature_names_in

from cyclofeat._base.versions import documentation_site

__all__ = ["DocumentedEstimator", "Interval", "StrOptions", "check_feature_names_in", "fit_context"]


class DocumentedEstimator(BaseEstimator):
    """Base of all estimators: in a notebook, their HTML links to their page of the documentation.

    Estimators of users, which inherit from it, have no page and no link.
    """

    _doc_link_module = "cyclofeat"

    @property
    def _doc_link_template(self) -> str:
        site = documentation_site()
        return f"{site}/generated/{{page}}.html" if site else ""

    def _doc_link_url_param_generator(self, *_: object) -> dict[str, str]:
        """Return the name of the page: that of the first package that exports the class."""
        kind = type(self)
        packages = accumulate(kind.__module__.split("."), lambda path, part: f"{path}.{part}")
        package = next(path for path in packages if getattr(sys.modules[path], kind.__name__, None) is kind)
        return {"page": f"{package}.{kind.__name__}"}
