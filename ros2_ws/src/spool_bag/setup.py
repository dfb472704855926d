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
    zip_safe=True,
    extras_require={"test": ["pytest"]},
    maintainer="Spool suite maintainers",
    maintainer_email="maintainers@spool-suite.org",
    description="Recording to MCAP, reading, import and export of records, and the recorder node.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": ["recorder = spool_bag.program:recorder", "adapter = spool_bag.program:adapter"],
        "spool.sources": ["adapter = spool_bag.adapter_node:AdapterNode"],
    },
)
