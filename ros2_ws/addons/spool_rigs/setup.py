from xml.etree import ElementTree

from setuptools import find_namespace_packages, setup

PACKAGE = "spool_rigs"

setup(
    name=PACKAGE,
    version=ElementTree.parse("package.xml").findtext("version"),
    packages=find_namespace_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    extras_require={"test": ["pytest"]},
    entry_points={
        PACKAGE: ["gap = spool_rigs.analyse:gap_of_forces", "exhibits = spool_rigs.pictures:exhibits"]
    },
)
