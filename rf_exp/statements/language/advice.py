"""What to say in place of words that people often use, and that no statement stands for."""

import re

_ORDER = re.compile(r"\b(?:before|after|until|once|then|while|when|as soon as|waits?)\b")
_EDGE = re.compile(r"\b(?:begin|start|finish|end|complete)(?:s|es|ed|ing)?\b|\b(?:began|begun|done)\b")
_ADVERB = re.compile(r"\b(vertical|horizontal|perpendicular)(?:ly)?\b|\bfrom (?:above|the side)\b")
_STOP = re.compile(r"\b(?:stop(?:s|ped|ping)?|pauses?|halts?)\b")


def advice(sentence: str) -> str:
    """Advice for a normalised sentence that is not understood, to end its message with; empty for none."""
    if _STOP.search(sentence):
        return (
            "; no plan says when an agent stops: say when it 'has finished', or what it 'has finished' doing"
        )
    if _ORDER.search(sentence) and _EDGE.search(sentence):
        return (
            "; an order is between what is over and what begins: say 'Agent_2 must complete its task before "
            "Agent_1 begins.'"
        )
    if _ADVERB.search(sentence):
        return (
            "; of a thing say 'Agent_1 must keep lid level.', of a gripper 'The gripper of Agent_1 must be "
            "vertical at lid when lifting it.'"
        )
    return ""
