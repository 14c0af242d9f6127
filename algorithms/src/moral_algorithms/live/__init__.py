"""People in the loop: who answers or demonstrates in a browser or a terminal.

Training and what people see are two processes that meet in the run directory alone (docs/live-protocol.md).
What a browser needs comes with ``pip install 'moral-algorithms[live]'``; the terminal needs nothing more.
"""
