"""Tasks in free language, and the trajectories that do them (OpenNav): what is around is described,
a language model or the rules write a coarse trajectory, a map of values refines it.

Beside the loop: nothing here runs in a tick, and nothing here drives.
"""
