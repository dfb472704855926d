from xml.etree import ElementTree

from setuptools import find_namespace_packages, setup

PACKAGE = "spool_design"

setup(
    name=PACKAGE,
    version=ElementTree.parse("package.xml").findtext("version"),
    packages=find_namespace_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={PACKAGE: ["sources/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    extras_require={"test": ["pytest"]},
    entry_points={
        "spool.commands": ["spool_design = spool_design"],
        "spool_design": ["fmu = spool_design.fmu:export_fmu", "setups = spool_design.setups_run:run_setups"],
    },
)
