"""Install spool_bag as an ament_python package."""

from setuptools import find_packages, setup

PACKAGE = "spool_bag"

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
    description="Recording to MCAP, reading, import and export of records, and the recorder node.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "recorder = spool_bag.program:main",
            "adapter = spool_bag.adapter.program:main",
        ],
        "spool.sources": ["adapter = spool_bag.adapter.adapter_node:AdapterNode"],
    },
)
