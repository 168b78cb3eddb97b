#ifdef @NAME@_SELF_TEST
/* Largest difference of an action from the policy that this was made from. */
static inline float @name@_self_test(void)
{
    /* number of others, own type, the others' */
    static const int kinds[@samples@][@kinds@] = {
@test_kinds@};
    /* own and others' position, velocity, goal; then the rest of what a drone knows of itself */
    static const float states[@samples@][@numbers@] = {
@test_states@};
    static const float actions[@samples@][@actions@] = {
@test_actions@};
    float worst = 0.0f;
    int n, j, k;
    for (n = 0; n < @samples@; n++) {
        struct @name@_drone drones[@drones@];
        struct @name@_own own;
        float action[@actions@];
        const float *s = states[n];
        for (j = 0; j < @drones@; j++) {
            for (k = 0; k < 3; k++) drones[j].position[k] = *s++;
            for (k = 0; k < 3; k++) drones[j].velocity[k] = *s++;
            for (k = 0; k < 3; k++) drones[j].goal[k] = *s++;
@test_load@            drones[j].type = kinds[n][1 + j];
        }
        for (k = 0; k < 3; k++) own.up[k] = *s++;
        own.thrust = *s++;
        for (k = 0; k < 3; k++) own.setpoint[k] = *s++;
@test_own@
        if (!@name@_act(drones, &own, kinds[n][0], drones + 1, action)) return 1.0f;
        for (k = 0; k < @actions@; k++) {
            const float error = fabsf(action[k] - actions[n][k]);
            if (error > worst) worst = error;
        }
    }
    return worst;
}
#endif

#endif
