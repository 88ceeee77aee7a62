"""Kernels of selection and detection, compiled by numba."""
