"""Which pixels of a box show the thing itself: segmenters, and what makes masks with them.

They work beside the loop, on the detector's worker; the loop sees masks as a part of `Detections`.
No box is found here, and nothing is lifted.
"""
