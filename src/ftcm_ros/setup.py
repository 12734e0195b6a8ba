# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

NODES = ("plant", "injector", "observer", "controller", "detector", "recorder")

setup(
    name="ftcm_ros",
    version="0.1.0",
    description="Fault-tolerant control of manipulators as ROS 2 nodes",
    maintainer="FTCM maintainers",
    maintainer_email="ftcm-maintainers@example.org",
    license="Apache-2.0",
    packages=find_packages(include=["ftcm_ros", "ftcm_ros.*"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/ftcm_ros"]),
        ("share/ftcm_ros", ["package.xml"]),
        (
            "share/ftcm_ros/launch",
            ["launch/experiment.launch.py", "launch/node.launch.py", "launch/viewer.launch.py"],
        ),
    ],
    package_data={"ftcm_ros.transport": ["fastdds.xml", "fastdds_viewer.xml"]},
    zip_safe=False,
    python_requires=">=3.10",
    # rclpy and the message packages come with ROS, not from here.
    install_requires=[
        "ftcm_core==0.1.0",
        "mcap>=1.2,<2",
        "psutil>=5.9.8",
        "rosbags>=0.11.9,<0.12",
        "tqdm>=4.66",
    ],
    entry_points={
        "console_scripts": [
            *(f"{node} = ftcm_ros.nodes.{node}:main" for node in NODES),
            "composed = ftcm_ros.nodes.composed:main",
            "experiment = ftcm_ros.run.experiment:main",
            "analyse = ftcm_ros.analysis.analyse:main",
            "drive = ftcm_ros.run.drive:main",
            "fault = ftcm_ros.run.fault:main",
            "markers = ftcm_ros.viewer.markers:main",
            "replay = ftcm_ros.analysis.replay:main",
            "watch = ftcm_ros.run.watch:main",
        ],
        "ftcm.commands": [
            "doctor = ftcm_ros.doctor:examine",
            "replay = ftcm_ros.analysis.replay:replay_bags",
            "watch = ftcm_ros.run.watch:watch",
        ],
    },
)
