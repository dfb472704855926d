from xml.etree import ElementTree

from setuptools import find_namespace_packages, setup

PACKAGE = "spool_sim"

setup(
    name=PACKAGE,
    version=ElementTree.parse("package.xml").findtext("version"),
    packages=find_namespace_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    package_data={PACKAGE: ["valves/*.yaml", "py.typed"]},
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": ["simulator = spool_sim.program:main"],
        "spool.sources": ["simulator = spool_sim.simulator_node:SimulatorNode"],
    },
)
