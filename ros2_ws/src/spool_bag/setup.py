from xml.etree import ElementTree

from setuptools import find_namespace_packages, setup

PACKAGE = "spool_bag"

setup(
    name=PACKAGE,
    version=ElementTree.parse("package.xml").findtext("version"),
    packages=find_namespace_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    package_data={PACKAGE: ["importing/*.yaml"]},
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": ["recorder = spool_bag.program:recorder", "adapter = spool_bag.program:adapter"],
        "spool.sources": ["adapter = spool_bag.adapter_node:AdapterNode"],
    },
)
