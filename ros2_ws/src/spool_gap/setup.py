from xml.etree import ElementTree

from setuptools import find_namespace_packages, setup

PACKAGE = "spool_gap"

setup(
    name=PACKAGE,
    version=ElementTree.parse("package.xml").findtext("version"),
    packages=find_namespace_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    extras_require={"test": ["pytest"]},
    # What the estimator asks for while a stream is live: it stands below this package and imports none of it.
    entry_points={
        "spool.gap_analysis": [
            "analyse = spool_gap.evidence.analyse:analyse",
            "to_dict = spool_gap.report:result_to_dict",
        ]
    },
)
