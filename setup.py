"""Which packages are installed; all else about the project is in pyproject.toml."""

from setuptools import find_namespace_packages, setup

# conf/ is at the top of the checkout and inside of the package where that is installed: at the top of
# site-packages, any other package may write to a folder of that name. See rf_exp/installed.py.
conf = find_namespace_packages(include=["conf*"])

setup(
    packages=[*find_namespace_packages(include=["rf_exp*"]), *(f"rf_exp.{name}" for name in conf)],
    package_dir={"rf_exp.conf": "conf"},
)
