// What was blended, before the scene's background.
uniform highp sampler2D uBlended;
uniform vec3 uBackground;
uniform vec2 uCorner;  // of the picture in its target, px
out highp vec4 oColour;

void main() {
    vec4 blended = texelFetch(uBlended, ivec2(gl_FragCoord.xy - uCorner), 0);
    oColour = vec4(clamp(blended.rgb + blended.a * uBackground, 0.0, 1.0), 1.0);
}
