"""Adapters to the stacks that robots run: Swarm-SLAM on ROS 2, over DDS, over Zenoh, or from a bag.

Nothing here is loaded by the rest of the package, and the packages that it needs (``cyclonedds``,
``eclipse-zenoh``, ``rosbags``) are imported inside functions only.
"""
