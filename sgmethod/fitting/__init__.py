"""What every fit is made of: the picture with its loss, the optimiser, the schedule, the record of error against time.

A picture and Gaussians to start from come in, and are moved step by step.
The profiles in paper/ and rd/ say which steps; nothing here knows of files or budgets.
"""
