"""What efforts, previews and experiments choose. Other numbers of the method are constants beside their code.

rd.py has the settings of the default profile, shared.py the groups that every profile uses. docs/notebook has the
measurement behind each number, on photographs outside Kodak.
"""
