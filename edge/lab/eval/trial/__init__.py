"""`edge trajectory`: one task in one place, from what a camera and a LiDAR show and a sentence to a
refined trajectory, its pictures and its page. What measures many of them lives beside it."""
