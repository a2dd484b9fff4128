"""What a fit is made of: the picture at every size, what its errors count, the time there is, the trace.

Pixels, a tuning and a time limit come in; levels, an objective and a deadline leave.
The profiles in paper/ and rd/ say which steps a fit takes; nothing here knows of files or budgets.
"""
