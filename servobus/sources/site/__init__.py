# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The first folder on the path of a tapped program: a sitecustomize, and nothing else."""
