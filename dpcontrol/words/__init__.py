"""The sentences that people read: results, events and causes in words.

Causes are members of enumerations with numbers beside them. This package turns them into sentences, and nothing that
computes reads a sentence back. It imports only `dpcontrol.foundation`, so results of all stages can ask it.
"""
