# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
# puma-sim on ROS 2 Jazzy, by the lines of docs/ros.md. It was written, not built: nobody has run it yet.
#   docker build -t puma-sim .
#   docker run --rm -it --network host puma-sim ros2 run puma_sim_ros sim_node
FROM ros:jazzy-ros-base

RUN apt-get update \
    && apt-get install -y --no-install-recommends python3-venv python3-pip python3-colcon-common-extensions \
    && rm -rf /var/lib/apt/lists/*

WORKDIR /ws
COPY . src/puma-sim
# RViz and robot_state_publisher need a screen
ENV PUMA_SIM_HEADLESS=1
SHELL ["/bin/bash", "-c"]
RUN apt-get update && rosdep update \
    && rosdep install --from-paths src --ignore-src -y \
    && rm -rf /var/lib/apt/lists/*
RUN python3 -m venv --system-site-packages .venv && touch .venv/COLCON_IGNORE \
    && source /opt/ros/jazzy/setup.bash && source .venv/bin/activate \
    && pip install --no-cache-dir mcap rosbags threadpoolctl numba viser \
    && python -m colcon build
RUN printf '%s\n' '#!/bin/bash' 'source /ws/.venv/bin/activate' 'source /ws/install/setup.bash' 'exec "$@"' \
        > /entrypoint.sh && chmod +x /entrypoint.sh

ENTRYPOINT ["/entrypoint.sh"]
CMD ["ros2", "run", "puma_sim_ros", "sim_node"]
