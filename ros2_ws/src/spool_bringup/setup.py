from xml.etree import ElementTree

from setuptools import find_namespace_packages, setup

PACKAGE = "spool_bringup"

setup(
    name=PACKAGE,
    version=ElementTree.parse("package.xml").findtext("version"),
    packages=find_namespace_packages(include=[PACKAGE, f"{PACKAGE}.*", "spool"]),
    package_data={"spool": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/launch", ["launch/valve.launch.py"]),
        (
            f"share/{PACKAGE}/config",
            ["config/valve.yaml", "config/valves.yaml", "config/diagnostic_aggregator.yaml"],
        ),
    ],
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": ["spool = spool_bringup.program:main", "host = spool_bringup.host.program:main"]
    },
)
