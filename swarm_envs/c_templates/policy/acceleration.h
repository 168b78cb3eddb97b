/* Let an action steer the set-point; then advance it. */
static inline void @name@_steer(const float action[3], struct @name@_setpoint *s)
{
    float asked[3];
    int k;
    for (k = 0; k < 3; k++) asked[k] = @limit@ * action[k];
    @name@_accelerate(asked, s);
}

