"""Install spool_sim as an ament_python package."""

from setuptools import find_packages, setup

PACKAGE = "spool_sim"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    package_data={PACKAGE: ["valves/*.yaml"]},
    zip_safe=True,
    extras_require={"test": ["pytest"]},
    maintainer="Spool suite maintainers",
    maintainer_email="maintainers@spool-suite.org",
    description="Physics of a spool in a vibrating valve body.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": ["simulator = spool_sim.program:main"],
        "spool.sources": ["simulator = spool_sim.simulator_node:SimulatorNode"],
    },
)
