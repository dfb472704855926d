"""Install spool_import as an ament_python package."""

from setuptools import find_packages, setup

PACKAGE = "spool_import"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    zip_safe=True,
    maintainer="Spool suite maintainers",
    maintainer_email="maintainers@spool-suite.org",
    description="Import of any logger's file: formats, units, clocks.",
    license="Apache-2.0",
    extras_require={"test": ["pytest"]},
    entry_points={"console_scripts": []},
)
