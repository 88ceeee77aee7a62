"""The inner loops of selecting and detecting, compiled by numba: arrays in, arrays out, no scene."""
