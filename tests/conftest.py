"""Settings of all tests."""

from __future__ import annotations

import os

from hypothesis import settings

# No deadline: a loaded machine is no error. The same examples every time where a change is judged, new ones elsewhere.
settings.register_profile("thermofit", deadline=None, derandomize=bool(os.environ.get("CI")))
settings.load_profile("thermofit")
