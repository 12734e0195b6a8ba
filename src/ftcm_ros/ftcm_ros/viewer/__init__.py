# SPDX-License-Identifier: Apache-2.0
"""A run that is on, in a browser: the arm, moving plots, tables and, where asked for, controls."""
