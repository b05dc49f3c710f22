"""Print a constraint that holds each run-time dependency at the oldest version pyproject.toml admits."""

import tomllib
from pathlib import Path

project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
for requirement in project["dependencies"]:
    name, floor = requirement.split(">=")
    # ".*": the newest patch of that minor version, since a first release may lack a wheel or a fix.
    print(f"{name}=={floor}.*")
