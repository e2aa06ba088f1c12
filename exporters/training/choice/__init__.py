"""The small choice scorer of our own, made from nothing but code and a seed.

`collect` has a robot explore built-in houses and keeps what it saw at each choice: the image, the
frontiers in it, and how far each truly is from every thing; `features` reads the images with the
trunk of the small detector (`exporters.training.mini`), which stays as it is; `net` is what answers
ViTL's two questions by these, `training` teaches it, `evaluate` measures it on houses that training
never saw, `export` joins trunk and net into one ONNX file with its card. The scorer knows the
built-in world and nothing else.
"""
