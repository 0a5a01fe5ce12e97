# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The ROS 2 side of the simulator: conversion, parameters, pacing. The arm is in puma_sim_core."""
