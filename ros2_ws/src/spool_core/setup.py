"""Install spool_core as an ament_python package."""

from setuptools import find_packages, setup

PACKAGE = "spool_core"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    zip_safe=True,
    extras_require={"test": ["pytest"]},
    maintainer="Spool suite maintainers",
    maintainer_email="maintainers@spool-suite.org",
    description="What every part of the suite shares.",
    license="Apache-2.0",
    entry_points={"console_scripts": []},
)
