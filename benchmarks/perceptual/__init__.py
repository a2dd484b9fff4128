"""What people see, in figures: nearness by networks that were trained for it, and by a model of the eye.

Pictures and weights of the networks come in, both from folders.
For each picture and rate five figures leave, of files with and without texture and of AVIF at the same bytes.
"""
