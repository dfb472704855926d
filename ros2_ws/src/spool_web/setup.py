"""Install spool_web as an ament_python package."""

from setuptools import find_packages, setup

PACKAGE = "spool_web"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={PACKAGE: ["site/*.*", "site/vendor/uplot/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    zip_safe=False,
    extras_require={"test": ["pytest"]},
    maintainer="Spool suite maintainers",
    maintainer_email="maintainers@spool-suite.org",
    description="Operator's page of the spool valve suite.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": ["page = spool_web.program:main"],
        "spool.pages": ["page = spool_web.serve:serve"],
    },
)
