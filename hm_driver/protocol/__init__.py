"""The HapticMASTER's language: text to typed commands and replies, dialects and framing; no input or output.

``vocabulary`` holds the command language as data, ``commands`` and ``replies`` turn it into text and back,
``framing`` turns text into bytes and back, ``numbers`` says how a number looks on the wire.
"""
