#ifdef @NAME@_SELF_TEST
/* Largest difference from the float64 model, gram-force. */
static inline float @name@_self_test(void)
{
    /* own type, the neighbors' types */
    static const int kinds[@samples@][1 + @neighbors@] = {
@test_types@};
    /* height, own velocity, the neighbors' offsets and relative velocities, force (N) */
    static const float states[@samples@][7 + 6 * @neighbors@] = {
@test_states@};
    float worst = 0.0f;
    int k, axis;
    for (k = 0; k < @samples@; k++) {
        const float *s = states[k];
        const float position[3] = {0.0f, 0.0f, s[0]};
        float force[3];
        @name@_force(kinds[k][0], position, s + 1, @neighbors@, kinds[k] + 1, s + 4, force);
        for (axis = 0; axis < 3; axis++) {
            float error = (force[axis] - s[4 + 6 * @neighbors@ + axis]) / @gram@;
            if (error < 0.0f) error = -error;
            if (error > worst) worst = error;
        }
    }
    return worst;
}
#endif

#endif
