"""Building blocks of a fit: the picture at every size, the objective, the deadline, the trace.

The profiles define the steps of a fit; no module here knows about budgets.
"""
