"""Damaged and hostile input for every reader of foreign files, each in a process that may die of it.

``python -m fuzz --help`` runs it by hand (with ``tools`` and ``tests/support`` on the path), ``make fuzz`` for long;
``test_fuzz.py`` is the short run of the test suite.
"""
