"""Sentences for people: each cause, with the numbers beside it, as text.

Everything that computes ends with a member of an enumeration (`dpcontrol.foundation.causes`). The tables here turn the
members into sentences, and nothing reads a sentence back. Results ask for theirs in the property `status`, so this
package is below them and imports `dpcontrol.foundation` only.
"""
