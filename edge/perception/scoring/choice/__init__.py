"""VLM frontier selection: asks a vision-language model which frontier to go to (ViTL IV-B).

This package has the set-of-marks pictures, the questions and the answers. The loop decides when to
ask, and how to use an answer.
"""
