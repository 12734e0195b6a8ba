# SPDX-License-Identifier: Apache-2.0
"""The report as one HTML file: it needs nothing but a browser, and fetches nothing."""
