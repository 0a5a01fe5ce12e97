# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What the arm is: parameters, kinematics, rigid body and third-order model (chapters 2 to 5)."""
