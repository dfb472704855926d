"""Install spool_adapter as an ament_python package."""

from setuptools import find_packages, setup

PACKAGE = "spool_adapter"

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
    description="Accelerometers with a ROS driver as sources of the suite.",
    license="Apache-2.0",
    # `spool_stream` has the executable: what it is called by stands below every node, and imports none.
    entry_points={
        "console_scripts": [],
        "spool.nodes": ["adapter = spool_adapter.program:main"],
        "spool.sources": ["adapter = spool_adapter.adapter_node:AdapterNode"],
    },
)
