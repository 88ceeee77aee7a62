"""Kernels of codecs, splat by splat: imported when the first packed scene is read or written.

One pass over the rows of a file writes a scene's arrays, and one pass over those the rows: numpy takes a pass
and an array for each step, which is 5 to 15 times as long. Numbers of few bits are looked up in tables that
`packing` makes in float64, so what is decoded is the same to the last bit on every machine.
"""
