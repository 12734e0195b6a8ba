# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="ftcm_core",
    version="0.1.0",
    description="Fault-tolerant sliding-mode control of manipulators, without ROS",
    maintainer="FTCM maintainers",
    maintainer_email="ftcm-maintainers@example.org",
    license="Apache-2.0",
    packages=find_packages(include=["ftcm_core", "ftcm_core.*"]),
    # ftcm_core/config is a link to the workspace's config/: one copy of each scenario.
    package_data={
        "ftcm_core": [
            "py.typed",
            "config/**/*.yaml",
            "config/**/*.urdf",
            "config/layouts/*",
            "config/rviz/*",
            "report/page/page.*",
        ]
    },
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/ftcm_core"]),
        ("share/ftcm_core", ["package.xml"]),
    ],
    zip_safe=False,
    python_requires=">=3.10",
    install_requires=["numpy>=1.26", "PyYAML>=6.0.1", "tabulate>=0.9", "tqdm>=4.66"],
    extras_require={
        "figures": ["matplotlib>=3.6"],
        "compiled": ["numba>=0.61"],
        "completion": ["argcomplete>=3.1"],
        "notebook": ["pandas>=2.0"],
        "mujoco": ["mujoco>=3.2.3"],
        "web": ["viser>=1.1", "websockets>=15"],
        "statistics": ["scipy>=1.11"],
        "parquet": ["pyarrow>=14"],
        "tune": ["optuna>=5.0", "scipy>=1.11"],
        "cluster": ["distributed>=2024.4"],
        "arms": ["example-robot-data>=4.4"],
    },
    entry_points={"console_scripts": ["ftcm = ftcm_core.cli:main"]},
)
