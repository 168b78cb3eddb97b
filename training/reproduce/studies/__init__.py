"""Studies beside the paper's figures: what its controller claims, and where compensation ends.

`lag`: eq. (22) on and off. `ball`: Theorem 5 on the point mass it assumes, and on the quadrotor.
`limits`: how the gain of compensation falls when belief, sensors or motors get worse. Each returns
its numbers and what to print, and writes a picture, a JSON file and a CSV table.
"""
