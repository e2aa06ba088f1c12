"""A vision-language model that is asked which frontier to go to (ViTL IV-B).

Pictures, questions and answers; when to ask, and what to make of it, is the loop's.
"""
