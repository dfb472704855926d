from glob import glob
from xml.etree import ElementTree

from setuptools import find_namespace_packages, setup

PACKAGE = "spool_view"

setup(
    name=PACKAGE,
    version=ElementTree.parse("package.xml").findtext("version"),
    packages=find_namespace_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={PACKAGE: ["site/*.*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/layouts", glob("layouts/*")),
    ],
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": ["page = spool_view.program:page", "opcua = spool_view.program:opcua"],
        "spool.pages": ["page = spool_view.page_node:serve"],
    },
)
