"""The gap in published statistics, without recordings (:func:`find_published_gap`)."""
