"""Line segments by the method of Nevatia and Babu, step by step.

R. Nevatia and K. R. Babu, "Linear feature extraction and description", Computer Graphics and
Image Processing 13(3), 1980. doi:10.1016/0146-664X(80)90049-0
"""
