"""Every number of the method and its source, in one small frozen group per step.

rd.py has the settings of the default profile, shared.py the groups that every profile uses. docs/notebook has the
measurement behind each number, on photographs outside Kodak.
"""
