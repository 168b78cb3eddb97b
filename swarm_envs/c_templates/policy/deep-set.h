/* The drone's own features and the @pooling@ of the neighbours' codes into values[0]. */
static inline void @name@_features(const struct @name@_drone *self, const struct @name@_own *own,
                                   int count, const int *found,
                                   const struct @name@_drone *other, float values[2][@widest@])
{
    float inner[2][@widest@], code[@code@];
    int j, k;
    for (k = 0; k < @code@; k++) code[k] = @first@;
    for (j = 0; j < count; j++) {
        const struct @name@_drone *o = &other[found[j]];
        const struct @name@_network *net = @phi_of@;
        const float *member;
        @name@_neighbour_features(self, o, inner[0]);
        member = @name@_apply(net, 1, inner);
        for (k = 0; k < @code@; k++) @pool@
    }
    @name@_own_features(self, own, values[0]);
    for (k = 0; k < @code@; k++) values[0][@own_width@ + k] = @result@;
}

