
/* What the network is told of obstacles near the drone: five numbers of each. */
static inline void @name@_obstacles(const struct @name@_own *own, const float offset[3], float *x)
{
    float way[3];
    int j, k;
    for (j = 0; j < @obstacles@; j++, x += 5) {
        const int there = j < own->obstacles;
        for (k = 0; k < 3; k++) way[k] = there ? own->obstacle[j][k] - offset[k] : 0.0f;
        @name@_cut(way, @goal_seen@, x);
        x[3] = there ? expf(-@name@_length(way) / @near@) : 0.0f;
        x[4] = there ? 1.0f : 0.0f;
    }
}
